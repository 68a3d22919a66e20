"""Starts the program under whose name this file is installed: `wheel.sh` copies it once for each program.

The programs are in the package's library. The package itself is not imported, since NumPy and Gymnasium take longer to load than most
commands to run.
"""

import importlib.machinery
import importlib.util
import os
import pathlib
import signal
import sys
from types import ModuleType


def native() -> ModuleType:
    """The package's library, or an exit with what to do."""
    package = importlib.util.find_spec("fiatlux")
    for folder in (package and package.submodule_search_locations) or ():
        for suffix in importlib.machinery.EXTENSION_SUFFIXES:
            file = pathlib.Path(folder, f"_native{suffix}")
            spec = importlib.util.spec_from_file_location("fiatlux._native", file) if file.exists() else None
            if spec and spec.loader:
                module = importlib.util.module_from_spec(spec)
                spec.loader.exec_module(module)
                if hasattr(module, "run_program"):
                    return module
    sys.exit(
        f"{name}: the package fiatlux of {sys.executable} has no programs; install a wheel made by python/wheel.sh"
    )


# A descriptor that is closed would be the next file that is opened, and a result would be printed into it.
for number in range(3):
    try:
        os.fstat(number)
    except OSError:
        os.open(os.devnull, os.O_RDWR)
name = pathlib.Path(sys.argv[0]).name
library = native()
# Python's own handler would only note the signal. One that is ignored, as under nohup, stays so.
if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
library.run_program(name, sys.argv[1:])
