"""Virtual environments for the scripts here."""

import hashlib
import os
import subprocess
import sys
import venv
from pathlib import Path


def enter(script, environment, requirements):
    """Restarts a script in its environment, made or renewed when the requirements are not the installed ones."""
    python = environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if Path(sys.prefix).resolve() == environment.resolve():
        return
    digest = hashlib.sha256(requirements.read_bytes()).hexdigest()
    stamp = environment / "requirements.sha256"
    if not (python.exists() and stamp.exists() and stamp.read_text() == digest):
        print(f"making {environment.name} from {requirements.name}", file=sys.stderr)
        venv.create(environment, with_pip=True, clear=True)
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, "-r", str(requirements)], check=True, stdout=sys.stderr)
        stamp.write_text(digest)
    done = subprocess.run([str(python), str(Path(script).resolve()), *sys.argv[1:]])
    sys.exit(done.returncode)
