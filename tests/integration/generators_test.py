#!/usr/bin/env python3
"""Compares the rays of every generator with numpy, by the formulas of protocol/PROTOCOL.md.

  generators_test.py RAYNESTD RAYNEST
"""

import numpy

from daemon import DaemonTest, main

WIDTH, HEIGHT = 61, 43
SIZE = f"size={WIDTH}x{HEIGHT}"
ULP = 2.0**-23


def rotation(seed):
    """Returns a random rotation and position, as the 3x4 matrix of a pose."""
    generator = numpy.random.default_rng(seed)
    q, _ = numpy.linalg.qr(generator.normal(size=(3, 3)))
    if numpy.linalg.det(q) < 0:
        q[:, 0] *= -1
    return numpy.hstack([q, generator.uniform(-5, 5, size=(3, 1))]).astype(numpy.float32)


def words(array):
    return ",".join(repr(float(value)) for value in numpy.asarray(array).ravel())


def pixels():
    """Returns column and row of every pixel's centre, row by row, y down."""
    row, column = numpy.mgrid[0:HEIGHT, 0:WIDTH]
    return column.ravel() + 0.5, row.ravel() + 0.5


def placed(pose, directions, offsets=None):
    """Transforms rays of a sensor's frame to world space: origins and directions."""
    matrix = pose.astype(numpy.float64)
    origins = numpy.broadcast_to(matrix[:, 3], directions.shape)
    if offsets is not None:
        origins = origins + offsets @ matrix[:, :3].T
    return origins, directions @ matrix[:, :3].T


class Generators(DaemonTest):
    loads = {"hills": "builtin:terrain?size=8"}

    def generated(self, *generator):
        """Returns the daemon's origins and directions; no ray is traced."""
        file = self.out / "rays.npz"
        done = self.client.run("query", "hills", "--generate", *generator, "--kind", "null",
                               "--fields", "origin,direction", "-o", file)
        self.assertEqual(done.returncode, 0, done.stderr)
        with numpy.load(file) as columns:
            return columns["origin"], columns["direction"]

    def check(self, generator, origins, directions):
        got = self.generated(*generator)
        for name, have, want in zip(("origin", "direction"), got, (origins, directions)):
            self.assertEqual(have.shape, want.shape, name)
            scale = numpy.abs(want).max(axis=1, keepdims=True)
            worst = (numpy.abs(have - want) / scale).max()
            self.assertLessEqual(worst, 1.01 * ULP, name)

    def test_a_pinhole_looks_along_minus_z_with_y_up(self):
        pose = rotation(1)
        x, y = pixels()
        fx, fy, cx, cy = 50.5, 47.25, 29.5, 22.75
        directions = numpy.stack([(x - cx) / fx, (cy - y) / fy, -numpy.ones_like(x)], axis=1)
        self.check(["pinhole", SIZE, f"fx={fx}", f"fy={fy}", f"cx={cx}", f"cy={cy}",
                    f"pose={words(pose)}"], *placed(pose, directions))

    def test_a_camera_is_a_pinhole_with_its_axis_in_the_middle(self):
        x, y = pixels()
        step = numpy.tan(numpy.deg2rad(50.0) / 2) / (HEIGHT / 2)
        directions = numpy.stack([(x - WIDTH / 2) * step, (HEIGHT / 2 - y) * step,
                                  -numpy.ones_like(x)], axis=1)
        # From (1, 2, 3) along +x, the camera's right is +z.
        turned = numpy.stack([-directions[:, 2], directions[:, 1], directions[:, 0]], axis=1)
        origins = numpy.broadcast_to([1.0, 2.0, 3.0], turned.shape)
        self.check(["camera", SIZE, "fov=50", "lookat=1,2,3,9,2,3"], origins, turned)

    def test_orthographic_rays_are_parallel_in_a_window(self):
        pose = rotation(2)
        x, y = pixels()
        offsets = numpy.stack([(x / WIDTH - 0.5) * 12.5, (0.5 - y / HEIGHT) * 7.5,
                               numpy.zeros_like(x)], axis=1)
        directions = numpy.broadcast_to([0.0, 0.0, -1.0], offsets.shape)
        self.check(["orthographic", SIZE, "window=12.5x7.5", f"pose={words(pose)}"],
                   *placed(pose, directions, offsets))

    def test_an_equirectangular_image_has_its_middle_ahead_and_its_right_at_the_right(self):
        pose = rotation(3)
        x, y = pixels()
        azimuth = (x / WIDTH - 0.5) * 2 * numpy.pi
        elevation = (0.5 - y / HEIGHT) * numpy.pi
        directions = numpy.stack([numpy.cos(elevation) * numpy.sin(azimuth), numpy.sin(elevation),
                                  -numpy.cos(elevation) * numpy.cos(azimuth)], axis=1)
        self.check(["equirectangular", SIZE, f"pose={words(pose)}"], *placed(pose, directions))

    def lidar(self, elevations, offsets, origins, start, stop, count):
        """Returns directions and origins in the lidar's frame (x ahead, y left, z up), channel
        by channel."""
        head = numpy.deg2rad(start + (stop - start) * numpy.arange(count) / count)[None, :]
        azimuth = head + numpy.deg2rad(offsets)[:, None]
        elevation = numpy.broadcast_to(numpy.deg2rad(elevations)[:, None], azimuth.shape)
        directions = numpy.stack([numpy.cos(elevation) * numpy.cos(azimuth),
                                  numpy.cos(elevation) * numpy.sin(azimuth),
                                  numpy.sin(elevation)], axis=-1)
        ox, oy, oz = (origins[:, i][:, None] for i in range(3))
        places = numpy.stack([ox * numpy.cos(head) - oy * numpy.sin(head),
                              ox * numpy.sin(head) + oy * numpy.cos(head),
                              numpy.broadcast_to(oz, azimuth.shape)], axis=-1)
        return directions.reshape(-1, 3), places.reshape(-1, 3)

    def test_a_lidar_has_channels_of_their_own_angles_and_places(self):
        pose = rotation(4)
        elevations = numpy.array([-25, -3.25, 0, 14.5])
        offsets = numpy.array([1.5, -1.5, 0.25, 4])
        origins = numpy.array([[0.03, 0.01, 0.1], [0, 0, 0], [-0.02, 0, 0.05], [0, 0.5, 0]],
                              numpy.float32).astype(numpy.float64)
        directions, places = self.lidar(elevations, offsets, origins, -60, 120, 333)
        self.check(["lidar", f"elevations={words(elevations)}", "azimuths=-60:120:333",
                    f"azimuth_offsets={words(offsets)}", f"origin_offsets={words(origins)}",
                    f"pose={words(pose)}"], *placed(pose, directions, places))

    def test_a_lidar_without_a_place_has_the_identity_as_its_pose(self):
        elevations = numpy.linspace(-15, 15, 5)
        directions, _ = self.lidar(elevations, numpy.zeros(5), numpy.zeros((5, 3)), 0, 360, 100)
        sweep = "lidar", "elevations=-15:15:5", "azimuths=0:360:100"
        for place in ((), ("pose=1,0,0,0,0,1,0,0,0,0,1,0",)):
            origins, got = self.generated(*sweep, *place)
            self.assertTrue((origins == 0).all())
            self.assertLess(numpy.abs(got - directions).max(), ULP)

    def test_a_lidar_at_a_look_at_stands_upright_and_looks_ahead(self):
        elevations = numpy.linspace(-15, 15, 5)
        directions, _ = self.lidar(elevations, numpy.zeros(5), numpy.zeros((5, 3)), 0, 360, 100)
        # x ahead, y left, z up are the world's -z, -x, +y.
        world = numpy.stack([-directions[:, 1], directions[:, 2], -directions[:, 0]], axis=1)
        origins, got = self.generated("lidar", "elevations=-15:15:5", "azimuths=0:360:100",
                                      "lookat=1,2,3,1,2,0")
        self.assertTrue((origins == [1, 2, 3]).all())
        self.assertLess(numpy.abs(got - world).max(), ULP)

    def test_hemisphere_rays_are_a_shifted_lattice_of_the_seed(self):
        generator = numpy.random.default_rng(5)
        points = generator.normal(size=(40, 6)).astype(numpy.float32)
        numpy.save(self.out / "points.npy", points)
        samples, seed = 600, 2**63 + 12345
        origins, got = self.generated("hemisphere", f"points={self.out / 'points.npy'}",
                                      f"samples={samples}", f"seed={seed}", "margin=0")
        self.assertEqual(got.shape, (40 * samples, 3))
        self.assertTrue((origins == numpy.repeat(points[:, :3], samples, axis=0)).all())

        number = numpy.arange(1, 2 * 40 + 1, dtype=numpy.uint64)  # SplitMix64
        z = numpy.uint64(seed) + number * numpy.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> numpy.uint64(30))) * numpy.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> numpy.uint64(27))) * numpy.uint64(0x94D049BB133111EB)
        z = z ^ (z >> numpy.uint64(31))
        shift = ((z >> numpy.uint64(40)).astype(numpy.float64) * 2.0**-24).reshape(40, 2)

        k = numpy.arange(samples)
        u = numpy.mod((k + 0.5) / samples + shift[:, :1], 1)
        v = numpy.mod(k * 0.6180339887498949 + shift[:, 1:], 1)
        n = points[:, 3:].astype(numpy.float64)
        n /= numpy.linalg.norm(n, axis=1, keepdims=True)
        sign = numpy.copysign(1, n[:, 2])
        a = -1 / (sign + n[:, 2])
        b = n[:, 0] * n[:, 1] * a
        x = numpy.stack([1 + sign * n[:, 0]**2 * a, sign * b, -sign * n[:, 0]], axis=1)
        y = numpy.stack([b, sign + n[:, 1]**2 * a, -n[:, 1]], axis=1)
        local = numpy.stack([numpy.sqrt(u) * numpy.cos(2 * numpy.pi * v),
                             numpy.sqrt(u) * numpy.sin(2 * numpy.pi * v), numpy.sqrt(1 - u)],
                            axis=-1)
        want = numpy.einsum("psi,pij->psj", local, numpy.stack([x, y, n], axis=1))
        self.assertLess(numpy.abs(got - want.reshape(-1, 3)).max(), ULP)

    def test_what_a_generator_lacks_is_said(self):
        for generator, says in (
                (["fisheye"], "there are camera, pinhole"),
                (["pinhole", SIZE], "needs fx and fy above 0"),
                (["orthographic", SIZE], "needs window=WIDTHxHEIGHT"),
                (["lidar", "azimuths=0:360:100"], "needs elevations"),
                (["camera", "camera=unheard"], "unheard"),
                (["camera", "size=0x5"], "from 1 to 16384"),
                (["camera", "range=5:1"], "tmin <= tmax"),
                (["camera", "size=5"], "'5' is not WIDTHxHEIGHT"),
                (["camera", "fov=181"], "fov: '181' is not"),
                (["pinhole", "focal=5"], "its keys are size"),
                (["pinhole", "fx=9", "fov=50"], "fov is no key of pinhole"),
                (["equirectangular", "lookat=1,2,3,4,5,6", "camera=0"], "give one of them"),
                (["lidar", "elevations=0,1", "azimuth_offsets=1", "azimuths=0:1:1"],
                 "as many as elevations"),
                (["hemisphere"], "needs points"),
                (["equirectangular", "pose=1,2,3"], "12 numbers"),
        ):
            self.client.fails(2, says, "query", "hills", "--generate", *generator)


if __name__ == "__main__":
    main()
