"""Shared by the examples: connection options, a line of progress, errors on one line."""
import argparse
import os
import re
import sys

import numpy as np

import raynest

AXES = {"y": ((0, 2), 1), "z": ((0, 1), 2)}  # the axes of the ground, and the one that points up


def parser(description, example, source="builtin:forest", loaded=True):
    """Returns a parser whose help starts with an example. `loaded`: the source may be a scene's name."""
    made = argparse.ArgumentParser(usage=f"{example}\n\n%(prog)s [SOURCE] [options]",
                                   description=description)
    # No option begins with a digit: -33.9,151.2 is a value, as -1 is.
    made._negative_number_matcher = re.compile(r"^-[\d.]")
    made.add_argument("source", nargs="?", default=source, metavar="SOURCE",
                      help=f".glb, .gltf, builtin:NAME or root:PATH{', or the name of a loaded scene' if loaded else ''} "
                      "(%(default)s)")
    made.add_argument("--server", help="tcp://HOST:PORT or unix:PATH (RAYNEST_SERVER)")
    made.add_argument("--quiet", action="store_true", help="no progress")
    return made


def add_up(made):
    made.add_argument("--up", choices=AXES, default="y",
                      help="the axis that points up: y in glTF, z in most surveys (%(default)s)")


def count(text):
    """Parses a whole number of at least 1; the type of an option."""
    if not (text.isascii() and text.isdigit()) or int(text) < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least 1")
    return int(text)


def scene(client, source, origin=None):
    """Returns the loaded scene of that name, or loads the source, under a name of its own: others may have edited theirs."""
    if any(source == info["name"] for info in client.scenes()):
        return client.scene(source)
    return client.load(source, "example-" + re.sub(r"\W+", "-", os.path.basename(source)), origin=origin, replace=True)


def from_above(scene, ground, up="y"):
    """Rays that look straight down on the scene at points of the ground, (N, 2): (N, 6)."""
    flat, axis = AXES[up]
    rays = np.zeros((len(ground), 6))
    rays[:, flat], rays[:, axis], rays[:, 3 + axis] = ground, scene.info["box_max"][axis] + 1, -1
    return rays


def progress(quiet):
    """Returns a function that rewrites a line of the terminal; None if stderr is no terminal."""
    if quiet or not sys.stderr.isatty():
        return None

    def show(done, total, stage):
        end = "\n" if done == total else ""
        print(f"\r{stage} {100 * done // max(total, 1)} %  ", end=end, file=sys.stderr, flush=True)
    return show


def run(main):
    """Calls main(). Prints an error on one line and exits with the command line's code for it."""
    try:
        main()
    except raynest.Error as error:
        sys.exit(_fail(error, error.exit_code))
    except ValueError as error:  # numpy's, of an argument or a file
        sys.exit(_fail(error, 2))
    except OSError as error:
        sys.exit(_fail(f"{error.filename}: {error.strerror}", 1))
    except KeyboardInterrupt:
        sys.exit(_fail("interrupted; the request was cancelled", 130))


def _fail(error, code):
    print(f"{os.path.basename(sys.argv[0])}: {error}", file=sys.stderr)
    return code
