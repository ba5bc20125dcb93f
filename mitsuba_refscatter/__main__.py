"""``python -m mitsuba_refscatter`` is the command ``refscatter``."""

from .commands.main import main

if __name__ == "__main__":
    main()
