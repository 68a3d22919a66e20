"""Puts nginx, HAProxy and Caddy in front of a board, set up as docs/leaderboard.md says, and uses it through each of them.

    python3 tests/network/proxies.py PROGRAMS [nginx] [haproxy] [caddy]

PROGRAMS has `fiatlux` and `scorer`. Without names it takes the proxies that are installed, and fails if none is. Each is tried with a name of
its own and below a path of another site: pages, API, both clients, a broken upload, downloads in parts, and whose limits a visitor
is under. All runs in a network of its own, which needs util-linux and iproute2 but no root where users may have namespaces.
"""

import hashlib
import html
import http.client
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.parse
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
KNOWN = ("nginx", "haproxy", "caddy")
# In a network of its own no port is taken.
BOARD, SITE = "10.89.0.1:8080", "10.89.0.1:8000"
NEAR, FAR, VISITORS = "127.0.0.1:8080", "10.89.0.4", ("10.77.0.7", "10.77.0.8")
failures = []


def check(holds: bool, what: str, found: object = "") -> None:
    print(f"{'ok    ' if holds else 'FAILED'} {what}{'' if holds else f': {found}'}", flush=True)
    if not holds:
        failures.append(what)


def documented(row: str) -> list[str]:
    """The text that docs/leaderboard.md has between backquotes in the row of a proxy."""
    page = (ROOT / "docs/leaderboard.md").read_text()
    line = next(line for line in page.splitlines() if line.startswith(f"| {row}"))
    return re.findall(r"`([^`]+)`", line.split("|")[2])


def nginx(folder: Path, board: str, source: str | None) -> list[str]:
    """Compressed answers, as many sites have them, and the lines of the page."""
    lines = " ".join(documented("nginx")) + (f" proxy_bind {source};" if source else "")
    config = f"""user root; daemon off; master_process off; pid {folder}/nginx.pid; error_log {folder}/nginx.log;
        events {{}}
        http {{
            access_log off; gzip on; gzip_types *; gzip_proxied any;
            client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxied; fastcgi_temp_path {folder}/f;
            uwsgi_temp_path {folder}/u; scgi_temp_path {folder}/s;
            server {{
                listen {SITE};
                location / {{ proxy_pass http://{board}; {lines} }}
                location /board/ {{ proxy_pass http://{board}/; {lines} }}
            }}
        }}"""
    (folder / "nginx.conf").write_text(config)
    return ["nginx", "-c", str(folder / "nginx.conf"), "-p", str(folder), "-e", str(folder / "nginx.log")]


def haproxy(folder: Path, board: str, source: str | None) -> list[str]:
    lines = [line for line in documented("HAProxy") if line.startswith("option")]
    config = f"""defaults
    mode http
    timeout connect 5s
    timeout client 90s
    timeout server 90s
    {lines[0]}
frontend site
    bind {SITE}
    http-request replace-path ^/board/(.*) /\\1
    default_backend board
backend board
    compression algo gzip
    server board {board} {f"source {source}" if source else ""}
"""
    (folder / "haproxy.cfg").write_text(config)
    return ["haproxy", "-db", "-f", str(folder / "haproxy.cfg")]


def caddy(folder: Path, board: str, source: str | None) -> list[str]:
    """The same as the page's command, without its certificates, which Caddy would have the machine trust."""
    command = documented("Caddy on")[0]
    if not command.startswith("caddy reverse-proxy --from") or not command.endswith(f"--to {NEAR}"):
        sys.exit(f"docs/leaderboard.md has another command for Caddy: {command}")
    at = "handle_path /board/*" if (folder / "path").exists() else "handle"
    config = f"{{\n admin off\n auto_https off\n}}\nhttp://{SITE} {{\n encode gzip\n {at} {{\n  reverse_proxy {board}\n }}\n}}\n"
    (folder / "Caddyfile").write_text(config)
    return ["caddy", "run", "--adapter", "caddyfile", "--config", str(folder / "Caddyfile")]


PROXIES = {"nginx": nginx, "haproxy": haproxy, "caddy": caddy}


class Answer:
    def __init__(self, response: http.client.HTTPResponse) -> None:
        self.status, self.headers, self.body = response.status, response.headers, response.read()


def ask(path: str, *, method: str = "GET", headers: dict | None = None, source: str = VISITORS[0], site: str = SITE) -> Answer:
    connection = http.client.HTTPConnection(site, timeout=60, source_address=(source, 0))
    try:
        connection.request(method, path, headers=headers or {})
        return Answer(connection.getresponse())
    finally:
        connection.close()


def waits_for(site: str, what: str, *logs: Path) -> None:
    for _ in range(300):
        try:
            if ask("/health", site=site, source="10.89.0.1").status == 200:
                return
        except OSError:
            pass
        time.sleep(0.1)
    said = "\n".join(log.read_text()[-2000:] for log in logs if log.exists())
    sys.exit(f"{what} does not answer at {site}\n{said}")


def client_of_python() -> object:
    """Python's client alone, which needs no package."""
    spec = importlib.util.spec_from_file_location("submission", ROOT / "python/fiatlux/submission.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["submission"] = module
    spec.loader.exec_module(module)
    return module


def breaks_an_upload(client: object, at: str, token: str, bag: Path) -> str:
    """Begins a submission of a bag and sends half of it; returns its id."""
    service, name = client._Service(at, token), bag.name
    told = {"name": name, "bytes": bag.stat().st_size, "sha256": hashlib.sha256(bag.read_bytes()).hexdigest()}
    manifest = {"policy": "random", "version": "", "authors": [], "link": "", "licence": "", "note": "half"}
    begun = service.ask("POST", "/api/v1/submissions", {"manifest": manifest, "files": [told]})
    site = urllib.parse.urlsplit(at)
    connection = http.client.HTTPConnection(site.netloc, timeout=60)
    connection.putrequest("PUT", f"{site.path}/api/v1/submissions/{begun['id']}/files/{begun['files'][0]['place']}?offset=0")
    connection.putheader("Authorization", f"Bearer {token}")
    connection.putheader("Content-Length", str(told["bytes"]))
    connection.endheaders()
    connection.send(bag.read_bytes()[: told["bytes"] // 2])
    time.sleep(1)
    connection.close()
    time.sleep(1)
    return begun["id"]


def whose(log: Path) -> set[str]:
    """Addresses that the board has named for wrong tokens."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", log.read_text())
    return {line.rsplit("address=", 1)[1].split()[0] for line in text.splitlines() if "wrong tokens" in line}


def tries(name: str, path: str, token: str, bag: Path, log: Path, scorer: Path) -> None:
    """Everything that a reader and both clients do, by a proxy, at a path."""
    at, where = f"http://{SITE}{path}", f"{name}{path}"
    client = client_of_python()
    check(ask(f"{path}/ready").status == 200, f"{where}: ready")

    (bag.parent / "token").write_text(token)
    command = [scorer, "submit", bag, "--to", at, "--token", bag.parent / "token", "--author", "A", "--licence", "MIT"]
    for bags in ("full", "thin"):
        done = subprocess.run([*command, "--bags", bags, "--note", where + bags], capture_output=True, text=True)
        check(done.returncode == 0, f"{where}: scorer submit, {bags}", done.stdout + done.stderr)

    half = breaks_an_upload(client, at, token, bag)
    told = json.loads(ask(f"{path}/api/v1/submissions/{half}", headers={"Authorization": f"Bearer {token}"}).body)
    received = told["files"][0]["received"]
    check(0 < received <= bag.stat().st_size // 2, f"{where}: what arrived of a broken upload stays", received)
    sent = client.submit(bag, at, token, policy="random", note="half", bags="full")
    check(sent["id"] == half and sent["state"] != "uploading", f"{where}: Python's client goes on with it", sent)

    entries = {}
    for _ in range(300):
        listed = json.loads(ask(f"{path}/api/v1/submissions").body)
        entries = listed["submissions"] if isinstance(listed, dict) else listed
        # Of one run's submissions the board shows the last.
        if [entry["id"] for entry in entries if entry["state"] in ("graded", "verified")] == [half]:
            break
        time.sleep(0.2)
    states = {entry["id"]: entry["state"] for entry in entries}
    check(states.get(half) in ("graded", "verified"), f"{where}: the submission is on the board", states)

    download = f"{path}/runs/{half}/episodes/S05-s0-e0/bag"
    page = ask(f"{path}/runs/{half}").body.decode()
    found = re.search(r'href="(/runs/[^"]+/bag)"', page) or re.search(r'href="(/runs/[^"]+/episodes/[^"]+)"', page)
    if found:
        address = html.unescape(found[1])
        download = path + (address if address.endswith("/bag") else f"{address}/bag")
    whole, wanted = ask(download), bag.read_bytes()
    check(whole.status == 200 and whole.body == wanted, f"{where}: a bag is downloaded", (whole.status, len(whole.body)))
    etag, middle = whole.headers.get("ETag", ""), len(wanted) // 2
    rest = ask(download, headers={"Range": f"bytes={middle}-", "If-Range": etag})
    check(rest.status == 206 and rest.body == wanted[middle:], f"{where}: the second half alone", (rest.status, etag))
    gone = ask(download, headers={"Range": f"bytes={middle}-", "If-Range": '"another"'})
    check(gone.status == 200 and gone.body == wanted, f"{where}: the whole of a bag that has changed", gone.status)

    if not path:
        first = ask("/")
        check(first.status == 200 and b"<title>" in first.body, f"{where}: the first page", first.status)
        links = {html.unescape(link) for link in re.findall(r'(?:href|src)="(/[^"#]*)', first.body.decode() + page)}
        broken = {link: status for link in sorted(links) if (status := ask(link).status) not in (200, 303)}
        check(len(links) > 7 and not broken, f"{where}: {len(links)} links of its pages", broken)
        packed = ask("/", headers={"Accept-Encoding": "gzip"})
        check(packed.status == 200, f"{where}: the first page compressed", packed.status)

    # A visitor may write what it likes into the header; the limits are those of its address.
    for number in range(5):
        lies = {"X-Forwarded-For": f"203.0.113.{number}", "Forwarded": f"for=203.0.113.{number}", "Authorization": "Bearer no"}
        status = ask(f"{path}/api/v1/account", headers=lies, source=VISITORS[1]).status
        check(status == 401, f"{where}: wrong token {number} is refused", status)
    check(whose(log) == {VISITORS[1]}, f"{where}: they count for who sent them", whose(log))


def main() -> None:
    programs, names = Path(sys.argv[1]).resolve(), sys.argv[2:] or [name for name in KNOWN if shutil.which(name)]
    if not names or set(names) - set(KNOWN):
        sys.exit(f"proxies: none is installed, or unknown: {names or KNOWN}")
    if "FIATLUX_OWN_NETWORK" not in os.environ:
        own = ["unshare", "--net", "--map-root-user", sys.executable, *sys.argv]
        sys.exit(subprocess.run(own, env={**os.environ, "FIATLUX_OWN_NETWORK": "1"}).returncode)
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    for address in ("10.89.0.1", FAR, *VISITORS):
        subprocess.run(["ip", "address", "add", f"{address}/32", "dev", "lo"], check=True)
    with tempfile.TemporaryDirectory() as place:
        work = Path(place)
        played = [programs / "fiatlux", "evaluate", "--policy", "random", "--tasks", "S05", "--seeds", "0", "--out", work / "run"]
        subprocess.run(played, check=True, capture_output=True)
        bag = next((work / "run").rglob("*.mcap"))
        for name in names:
            # A proxy on the board's machine, one on another machine, and both below a path.
            for source in (None, FAR) if name != "caddy" else (None,):
                for path in ("", "/board"):
                    use(programs / "scorer", name, source, path, bag, work)
    if failures:
        sys.exit(f"{len(failures)} failed")


def use(scorer: Path, name: str, source: str | None, path: str, bag: Path, work: Path) -> None:
    folder = Path(tempfile.mkdtemp(dir=work))
    if path:
        (folder / "path").touch()
    board = BOARD if source else NEAR
    admin = lambda *args: subprocess.run([scorer, "admin", "--folder", folder / "board", *args], check=True, capture_output=True, text=True).stdout
    admin("init")
    admin("account", "lab")
    token = admin("token", "lab").split()[-1]
    log, said = folder / "board.log", folder / "said.log"
    trusted = ["--proxy", FAR] if source else []
    with log.open("w") as board_log, said.open("w") as proxy_log:
        served = subprocess.Popen([scorer, "serve", "--folder", folder / "board", "--http", board, *trusted], stdout=board_log, stderr=board_log)
        running = [served]
        try:
            waits_for(board, "the board", log)
            home = {**os.environ, "HOME": str(folder), "XDG_DATA_HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}
            running.append(subprocess.Popen(PROXIES[name](folder, board, source), stdout=proxy_log, stderr=proxy_log, env=home))
            if path and name == "caddy":
                time.sleep(3)
            else:
                waits_for(SITE, name, said, folder / "nginx.log", log)
            tries(name + (" elsewhere" if source else ""), path, token, bag, log, scorer)
        finally:
            for process in reversed(running):
                process.terminate()
                process.wait()
    if failures:
        print(said.read_text()[-2000:], log.read_text()[-2000:], sep="\n")


if __name__ == "__main__":
    main()
