"""Submits recorded episodes to a leaderboard; needs only the standard library."""

import hashlib
import http.client
import json
import time
import urllib.parse
from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

_BLOCK = 1 << 20
_TRIES = 8
_PATIENCE_S = 90.0


class SubmissionError(Exception):
    """The leaderboard refuses a request, or does not answer."""


def submit(
    folder: str | PathLike[str],
    to: str,
    token: str,
    *,
    policy: str | None = None,
    version: str = "",
    authors: tuple[str, ...] | list[str] = (),
    link: str = "",
    licence: str = "",
    note: str = "",
    wait: bool = False,
    bags: str = "thin",
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Sends the bags and journals of a run's folder, or loose bags, to the leaderboard at ``to``, such as ``https://HOST``, or
    ``https://HOST/PATH`` where a proxy has it below a path.

    Full bags are sent as thin ones, without the rows, which the leaderboard simulates again; ``bags="full"`` sends them whole.
    ``token`` is the text of an account's token. ``policy`` is by default the policy's name in the bags. An interrupted upload
    resumes where it stopped, even in a later call with the same arguments. ``progress`` is called with the bytes sent and the
    bytes in total. Returns the submission as the leaderboard reports it: ``id``, ``state``, ``reason``, ``badge`` and more; with
    ``wait``, once it is verified or refused.

    Raises :class:`SubmissionError` if the leaderboard refuses a request or does not answer, and ``ValueError`` if the folder
    does not exist, has no bags, or has bags of several runs.
    """
    if bags not in ("thin", "full"):
        raise ValueError(f"bags is {bags!r}; use 'thin' or 'full'")
    files = _files(Path(folder))
    if policy is None:
        from .bag import Bag

        policy = Bag(next(path for name, path in files.items() if name.endswith(".mcap"))).header["policy"]
    manifest = {
        "policy": policy,
        "version": version,
        "authors": list(authors),
        "link": link,
        "licence": licence,
        "note": note,
    }
    service = _Service(to, token)
    with TemporaryDirectory(prefix="fiatlux-submit-") as place:
        submission = _sent(service, manifest, _thinned(files, Path(place)) if bags == "thin" else files, progress)
    while wait and submission["state"] not in ("verified", "refused"):
        time.sleep(2.0)
        submission = service.ask("GET", f"/api/v1/submissions/{submission['id']}")
    return submission


def _thinned(files: dict[str, Path], place: Path) -> dict[str, Path]:
    """The files, with thin copies in a folder for full bags; as they are without the package, which makes thin ones."""
    try:
        from ._native import write_thin
    except ImportError:
        return files
    is_bag = lambda name: name.endswith(".mcap")
    return {
        name: place / name if is_bag(name) and write_thin(path, place / name) else path for name, path in files.items()
    }


def _sent(
    service: "_Service",
    manifest: dict[str, Any],
    files: dict[str, Path],
    progress: Callable[[int, int], None] | None,
) -> dict[str, Any]:
    """Sends the files that the service does not have yet, and finishes the submission."""
    listed: list[dict[str, Any]] = [
        {"name": name, "bytes": path.stat().st_size, "sha256": _sha256(path)} for name, path in files.items()
    ]
    submission = service.ask("POST", "/api/v1/submissions", {"manifest": manifest, "files": listed})
    if submission["state"] == "uploading":
        whole, done = sum(file["bytes"] for file in listed), 0
        for file in submission["files"]:
            service.send(submission["id"], file, files[file["name"]])
            done += file["bytes"]
            if progress is not None:
                progress(done, whole)
        submission = service.ask("POST", f"/api/v1/submissions/{submission['id']}/finish", {})
    return submission


def is_leftover(name: str) -> bool:
    """True for a file or folder that file systems leave behind: the rule of ``_native``, for this file works without the package."""
    return name.startswith((".", "$", "#", "@", "~")) or name in ("lost+found", "System Volume Information", "__MACOSX")


def _found(folder: Path, pattern: str) -> list[Path]:
    """The files below a folder, without leftovers."""
    return [path for path in sorted(folder.rglob(pattern)) if not any(map(is_leftover, path.relative_to(folder).parts))]


def _files(folder: Path) -> dict[str, Path]:
    """The files by the names under which they are submitted."""
    if not folder.exists():
        raise ValueError(f"there is no folder {folder}; name the folder of a run, or of *.mcap files")
    bags = _found(folder, "*.mcap") if folder.is_dir() else [folder] if folder.suffix == ".mcap" else []
    journals = _found(folder, "*.run.jsonl") if folder.is_dir() else []
    runs = {journal.parent for journal in journals}
    if len(runs) > 1:
        raise ValueError(f"{folder} holds {len(runs)} runs; submit each of them separately")
    if runs:
        # Journals name bags by their file names.
        bags = [bag for bag in bags if bag.parent in runs]
    if not bags:
        raise ValueError(f"there is no bag in {folder}; name the folder of a run, or of *.mcap files")
    files: dict[str, Path] = {}
    for index, path in enumerate(bags + journals):
        if not path.is_file():
            raise ValueError(f"{path} is not a regular file; move it out of {folder}")
        files[path.name if path.name not in files else f"{index}-{path.name}"] = path
    return files


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest() if hasattr(hashlib, "file_digest") else _digest(file)


def _digest(file: Any) -> str:
    digest = hashlib.sha256()
    while block := file.read(_BLOCK):
        digest.update(block)
    return digest.hexdigest()


class _Service:
    """One leaderboard, with the token of an account."""

    def __init__(self, url: str, token: str) -> None:
        parts = urllib.parse.urlsplit(url.rstrip("/"))
        if (
            parts.scheme not in ("http", "https")
            or not parts.hostname
            or parts.query
            or parts.fragment
            or parts.username
        ):
            raise ValueError(
                f"'{url}' is not the address of a leaderboard; write https://HOST, http://HOST:PORT or https://HOST/PATH"
            )
        self._url, self._prefix = url, parts.path
        self._address = (parts.hostname, parts.port)
        self._connect = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
        # A file that an editor of Windows wrote begins with a mark.
        token = token.removeprefix("\ufeff").strip()
        self._headers = {"Authorization": f"Bearer {token}"}

    def ask(self, method: str, path: str, content: Any = None) -> dict[str, Any]:
        """Sends a request without a file; tries again while the service does not answer."""
        body = None if content is None else json.dumps(content).encode()
        failure: object = None
        for pause in _pauses():
            time.sleep(pause)
            try:
                status, answer = self._request(method, path, body, len(body or b""))
            except (OSError, http.client.HTTPException) as error:
                failure = error
                continue
            if status < 300:
                return answer
            if status < 500:
                raise self._refused(status, answer)
            failure = self._refused(status, answer)
        raise SubmissionError(
            f"{self._url} does not answer ({failure}); try again later: the service keeps what has arrived"
        )

    def send(self, submission: str, file: dict[str, Any], path: Path) -> None:
        """Sends the missing part of a file."""
        received = file["received"]
        failure: object = None
        if file["stored"]:
            return
        for pause in _pauses():
            time.sleep(pause)
            try:
                with path.open("rb") as source:
                    source.seek(received)
                    where = f"/api/v1/submissions/{submission}/files/{file['place']}?offset={received}"
                    status, answer = self._request("PUT", where, source, file["bytes"] - received)
            except (OSError, http.client.HTTPException) as error:
                failure = error
            else:
                if status == 200 and answer.get("stored"):
                    return
                if status in (400, 408, 409) or status >= 500 or status == 200:
                    failure = self._refused(status, answer)
                else:
                    raise self._refused(status, answer)
            told = self.ask("GET", f"/api/v1/submissions/{submission}")
            there = next((there for there in told.get("files", []) if there["place"] == file["place"]), None)
            if there is None:
                raise SubmissionError(f"the submission takes no more files; its state is {told['state']}")
            if there["stored"]:
                return
            received = there["received"]
        raise SubmissionError(
            f"{path} could not be sent ({failure}); try again later: the service keeps what has arrived"
        )

    def _request(self, method: str, path: str, body: Any, length: int) -> tuple[int, Any]:
        connection = self._connect(*self._address, timeout=_PATIENCE_S)
        headers = self._headers if method == "GET" else {**self._headers, "Content-Length": str(length)}
        try:
            connection.request(method, self._prefix + path, body=body, headers=headers)
            response = connection.getresponse()
            text = response.read()
        finally:
            connection.close()
        try:
            return response.status, json.loads(text)
        except ValueError:
            return response.status, {}

    @staticmethod
    def _refused(status: int, answer: Any) -> SubmissionError:
        said = answer.get("error", {}) if isinstance(answer, dict) else {}
        return SubmissionError(
            f"the leaderboard refuses ({said.get('code', status)}): {said.get('message', 'no reason given')}"
        )


def _pauses() -> Iterator[float]:
    """Pause before each try, s."""
    yield 0.0
    for power in range(_TRIES):
        yield min(0.5 * 2.0**power, 60.0)
