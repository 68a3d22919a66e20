"""Shared by all tests."""

import signal

# A job in the background of a script is started with SIGINT ignored. Python then installs no handler of it, and the tests
# of Ctrl-C would wait forever.
signal.signal(signal.SIGINT, signal.default_int_handler)
