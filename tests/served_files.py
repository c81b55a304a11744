"""A web server of a folder, which stops where it is told to, and goes on from a byte."""

import contextlib
import http.server
import threading


class Served:
    """A served folder: its address, and what was asked, as (path, range).

    ranges: whether a part of a file can be asked for. cut: bytes of a kernel after which an answer
    ends. moved: path -> the path that it redirects to. silent: to be set where it no longer waits;
    kernels are answered then.
    """

    def __init__(self, folder):
        self.folder, self.address, self.asked = folder, "", []
        self.ranges, self.cut, self.moved, self.silent = True, None, {}, None

    def answer(self, request):
        """Answer one request."""
        path, begin = request.path.lstrip("/"), 0
        asked = request.headers.get("Range")
        self.asked.append((path, asked))
        if path in self.moved:
            request.send_response(302)
            request.send_header("Location", self.moved[path])
            request.end_headers()
            return
        if not (self.folder / path).is_file():
            request.send_error(404)
            return
        data = (self.folder / path).read_bytes()
        if asked and self.ranges:
            begin = int(asked.removeprefix("bytes=").removesuffix("-"))
            if begin >= len(data):
                request.send_error(416)
                return
        if self.silent is not None and path.endswith(".nc"):
            self.silent.wait(5)
            return
        request.send_response(206 if begin else 200)
        if begin:
            request.send_header("Content-Range", f"bytes {begin}-{len(data) - 1}/{len(data)}")
        request.send_header("Content-Length", str(len(data) - begin))
        request.end_headers()
        cut = self.cut if path.endswith(".nc") and self.cut is not None else len(data)
        with contextlib.suppress(OSError):  # whoever asked has gone
            request.wfile.write(data[begin : begin + cut])

    def kernels_asked(self):
        """The ranges in which kernels were asked for, None for a whole."""
        return [asked for path, asked in self.asked if path.endswith(".nc")]


@contextlib.contextmanager
def served(folder):
    """The server of a folder while it runs."""
    web = Served(folder)

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            web.answer(self)

        def log_message(self, *given):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        web.address = f"http://127.0.0.1:{server.server_port}"
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        yield web
        server.shutdown()
