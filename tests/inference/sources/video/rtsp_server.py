"""An RTSP server of GStreamer, for the system's Python: raw pictures come by standard input.

Arguments: one JSON object, `Film` and the users (tests/inference/sources/video/senders.py).
"""

import json
import sys
import threading
import time

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
gi.require_version("GstRtsp", "1.0")
from gi.repository import GLib, Gst, GstRtsp, GstRtspServer  # noqa: E402
from stamps import Stamps  # noqa: E402 - the script's folder

PATH = "/video"


class Server:
    """One stream for all clients; what comes while nobody watches is thrown away."""

    def __init__(self, told):
        self.told = told
        self.feeds = []
        self.lock = threading.Lock()
        size = told["size"]
        self.bytes = size[0] * size[1] * 3 // 2
        self.caps = (
            f"video/x-raw,format=I420,width={size[0]},height={size[1]},framerate={told['rate']}/1"
        )
        server = GstRtspServer.RTSPServer()
        server.set_address("127.0.0.1")
        server.set_service(str(told["port"]))
        factory = GstRtspServer.RTSPMediaFactory()
        source = f"appsrc name=feed is-live=true do-timestamp=true format=time caps={self.caps}"
        factory.set_launch(f"( {source} ! {told['pipeline']} name=pay0 pt=96 )")
        factory.set_shared(True)
        factory.set_latency(0)
        factory.connect("media-configure", self.configure)
        if told["user"]:
            self.protect(server, factory)
        server.get_mount_points().add_factory(PATH, factory)
        server.attach(None)
        self.port = server.get_bound_port()
        self.server = server

    def protect(self, server, factory):
        """Ask for a name and a password: basic, digest or both."""
        auth = GstRtspServer.RTSPAuth()
        token = GstRtspServer.RTSPToken()
        token.set_string("media.factory.role", "user")
        methods = {"basic": GstRtsp.RTSPAuthMethod.BASIC, "digest": GstRtsp.RTSPAuthMethod.DIGEST}
        auth.set_supported_methods(methods[self.told["auth"]])
        if self.told["auth"] == "basic":
            basic = GstRtspServer.RTSPAuth.make_basic(self.told["user"], self.told["password"])
            auth.add_basic(basic, token)
        else:
            auth.add_digest(self.told["user"], self.told["password"], token)
        permissions = GstRtspServer.RTSPPermissions()
        permissions.add_permission_for_role("user", "media.factory.access", True)
        permissions.add_permission_for_role("user", "media.factory.construct", True)
        factory.set_permissions(permissions)
        server.set_auth(auth)

    def configure(self, factory, media):
        """A client has come: pictures go to it from now on."""
        feed = media.get_element().get_by_name("feed")
        with self.lock:
            self.feeds.append(feed)
        media.connect("unprepared", lambda media: self.feeds.remove(feed))

    def pass_on(self, stamps, number):
        """Hand on each picture, with the time at which it went in."""
        while len(data := sys.stdin.buffer.read(self.bytes)) == self.bytes:
            stamps.note(number, time.monotonic())
            with self.lock:
                for feed in self.feeds:
                    feed.emit("push-buffer", Gst.Buffer.new_wrapped(data))
            number += 1
        loop.quit()


if __name__ == "__main__":
    Gst.init(None)
    loop = GLib.MainLoop()
    told = json.loads(sys.argv[1])
    server = Server(told)
    print(server.port, flush=True)
    arguments = Stamps(told["stamps"]), told["first"]
    threading.Thread(target=server.pass_on, args=arguments, daemon=True).start()
    loop.run()
