"""The command line: what users type, what they are shown, and what is written; nothing is computed here."""
