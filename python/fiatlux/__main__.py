"""The launcher as a module, for environments whose commands are not on the path: ``python -m fiatlux evaluate ...``."""

import signal
import sys

from . import _native

run_program = getattr(_native, "run_program", None)
if run_program is None:
    sys.exit(f"fiatlux: the package of {sys.executable} has no programs; install a wheel made by python/wheel.sh")
# Python's own handler would only note the signal. One that is ignored, as under nohup, stays so.
if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
run_program("fiatlux", sys.argv[1:])
