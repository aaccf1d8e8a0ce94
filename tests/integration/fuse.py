"""A FUSE file system in this process: an empty folder in which files can be made. Mounts need root.

Its bytes are those of the kernel's uapi/linux/fuse.h.
"""
import ctypes
import errno
import os
import struct
import subprocess
import threading

LOOKUP, FORGET, GETATTR, STATFS, INIT, ACCESS, CREATE, BATCH_FORGET = 1, 2, 3, 17, 26, 34, 35, 42
HEADER = struct.Struct("<IIQQIIIHH")  # length, operation, request, node, and whose it is
FOLDER, FILE = 0o40700, 0o100600


def attributes(mode):
    return struct.pack("<6Q10I", 1, 0, 0, 0, 0, 0, 0, 0, 0, mode, 1, os.geteuid(), os.getegid(), 0, 4096, 0)


class Fuse:
    def __init__(self, folder):
        """Mounts, or fails with OSError where that is not possible."""
        self.folder = folder
        self.asked = set()
        self.made = []
        self.device = os.open("/dev/fuse", os.O_RDWR)
        options = f"fd={self.device},rootmode={FOLDER:o},user_id={os.geteuid()},group_id={os.getegid()}"
        if ctypes.CDLL(None, use_errno=True).mount(b"test", os.fsencode(folder), b"fuse", 0, options.encode()) != 0:
            error = ctypes.get_errno()
            os.close(self.device)
            raise OSError(error, os.strerror(error), str(folder))
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def close(self):
        subprocess.run(["umount", "-l", self.folder], check=False)
        self.thread.join()
        os.close(self.device)

    def serve(self):
        while True:
            try:
                request = os.read(self.device, 1 << 20)
            except OSError:
                return  # it is unmounted
            _, operation, number, node, *_ = HEADER.unpack_from(request)
            self.asked.add(operation)
            if operation in (FORGET, BATCH_FORGET):
                continue
            answer = self.answer(operation, node, request[HEADER.size:])
            error, content = (answer, b"") if isinstance(answer, int) else (0, answer)
            os.write(self.device, struct.pack("<IiQ", 16 + len(content), -error, number) + content)

    def answer(self, operation, node, content):
        """Returns a request's answer, or an error's number."""
        if operation == INIT:
            return struct.pack("<IIIIHHIIHHI28x", 7, 31, 0, 0, 0, 0, 4096, 1, 0, 0, 0)
        if operation == GETATTR:
            return struct.pack("<QII", 0, 0, 0) + attributes(FOLDER if node == 1 else FILE)
        if operation == STATFS:
            return struct.pack("<5Q4I24x", 1 << 20, 1 << 20, 1 << 20, 1 << 20, 1 << 20, 4096, 255, 4096, 0)
        if operation == ACCESS:
            return b""
        if operation == LOOKUP:
            return errno.ENOENT
        if operation == CREATE:
            self.made.append(content[16:].rstrip(b"\0").decode())
            entry = struct.pack("<4QII", 1 + len(self.made), 0, 0, 0, 0, 0) + attributes(FILE)
            return entry + struct.pack("<QII", 0, 0, 0)
        return errno.ENOSYS
