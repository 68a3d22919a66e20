"""Checks that need the package's extras; `extras.sh` runs them."""

import os

# In an environment without the extras they are left out, where `extras.sh` has them fail.
collect_ignore_glob = [] if "FIATLUX_EXTRAS" in os.environ else ["test_*.py"]
