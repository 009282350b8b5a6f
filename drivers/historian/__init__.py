"""Records as plants export them: historian text, tables of many loops, data frames; and what was assumed in reading."""
