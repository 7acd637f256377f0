"""`python -m dwgs` is `dwgs`."""

from dwgs.cli import main

main()
