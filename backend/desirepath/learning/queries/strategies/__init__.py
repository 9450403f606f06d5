"""The strategies of choosing the next query, one file each (`../choosing.py` finds them)."""
