"""The settings in force, read off a record by regression of co on the error."""
