"""Which gains are in force where: gains and their forms, the PID law, regions, the table. Pure."""
