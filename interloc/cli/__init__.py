"""The command line: it reads options, calls the library and speaks to the user."""
