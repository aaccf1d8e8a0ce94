"""A copy of the tree, and functions that add one thing of each kind to it, as server/README.md says."""
import re
import shutil
import subprocess


def run(*command, **options):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, **options)
    if done.returncode:
        raise AssertionError(f"{command} gave {done.returncode}:\n{done.stdout[-5000:]}{done.stderr[-3000:]}")
    return done.stdout


class Tree:
    """The tracked files of the tree, copied."""

    def __init__(self, source, root):
        self.root = root
        names = run("git", "-C", source, "-c", f"safe.directory={source}", "ls-files", "-z").split("\0")
        for name in filter(None, names):
            if (source / name).is_file() or (source / name).is_symlink():
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source / name, root / name, follow_symlinks=False)

    def edit(self, name, pattern, replacement):
        """In one place."""
        text, count = re.subn(pattern, lambda _: replacement, (self.root / name).read_text(), flags=re.M)
        if count != 1:
            raise AssertionError(f"{name} has {count} places like {pattern}")
        (self.root / name).write_text(text)

    def add_row(self, name, like, old, new):
        """A row like another one of the list, behind it."""
        text = (self.root / name).read_text()
        row = next(line for line in text.splitlines() if line.startswith(like))
        for word, other in zip(old, new, strict=True):
            if word not in row:
                raise AssertionError(f"{name}: '{row}' has no {word}")
            row = row.replace(word, other)
        self.edit(name, rf"^{re.escape(like)}.*$", f"{next(x for x in text.splitlines() if x.startswith(like))}\n{row}")


def add_counter(tree):
    tree.add_row("engine/geometry/counters.def", "RAYNEST_COUNTER(prim_hits",
                 ("prim_hits", "primitives hit"), ("pairs", "pairs of nodes"))
    tree.edit("engine/intersectors/counts.h", r"c\.box_hits \+= lanes_of\(entered\);",
              "c.box_hits += lanes_of(entered);\n    c.pairs += 2;")


def add_generator(tree):
    tree.add_row("protocol/lists/generators.def", "RAYNEST_GENERATOR(equirectangular",
                 ("equirectangular", "pose, range"), ("square_on", "pose, scale, range"))
    tree.add_row("protocol/lists/generators.def", "RAYNEST_SETTING(fx", ("fx", "in pixels"), ("scale", "over the width"))
    tree.edit("server/requests/words/generator.cpp", r"^Reply<Generated> make_equirectangular", """\
Reply<Generated> make_square_on(const Wanted& request) {
    if (!request.settings.scale) return lacks(request.kind, "scale");
    const double focal = request.settings.scale->at(0) * request.size.width;
    return ready(Pinhole{request.sensor_pose, request.size, 0, 0, 1 / focal, 1 / focal});
}

Reply<Generated> make_equirectangular""")


def add_error(tree):
    """The echo of `add_request` answers with it."""
    tree.add_row("protocol/lists/errors.def", "RAYNEST_ERROR(23",
                 ("23, FILE_UNUSABLE, file_unusable", "correct the daemon's file that the message names"),
                 ("24, TOO_LOUD, too_loud", "speak lower"))


def add_reducer(tree):
    """One float for each point that a client sends: the share of its rays that hit nothing."""
    tree.add_row("protocol/lists/reducers.def", "RAYNEST_REDUCER(hit_fraction",
                 ("hit_fraction, any", "hit_fraction f32", "that hit"), ("miss_fraction, any", "miss_fraction f32", "that miss"))
    tree.edit("server/jobs/reduce_job.cpp", r"^/// Maximum rays of visible_pixels: all", """\
class MissJob final : public QueryJob {
public:
    MissJob(const Services& services, const Caller& caller, Plan plan, RaySource source)
        : QueryJob(services, caller, std::move(plan), std::move(source)) {}

protected:
    [[nodiscard]] std::uint64_t chunk_size(const Backend&, const Chunk&) const override {
        return source_.rays_per_point();
    }
    [[nodiscard]] std::uint64_t reply_bytes(std::uint64_t) const override {
        return protocol::padded(sizeof(float));
    }
    [[nodiscard]] std::uint64_t rows() const override {
        return source_.rays() / source_.rays_per_point();
    }
    [[nodiscard]] std::uint64_t result_bytes() const override {
        return rows() * (protocol::alignment + answer_head_bytes_max);
    }
    Traced<Frames> trace(const Chunk& chunk, const Stop& stop, TraceBuffers& buffers) override {
        const auto traced = source_.trace(plan_, chunk, input_, stop, buffers, false);
        if (!traced) return tl::unexpected(traced.error());
        const auto counts = count_hits(*traced, chunk.first);
        protocol::Bulk bulk;
        bulk.add("miss_fraction", wire::Dtype::f32, 1, 1);
        bulk.allocate();
        bulk.block_as<float>(0)[0] = static_cast<float>(counts.misses) / static_cast<float>(counts.rays);
        auto frames = rows_frame(id_, chunk.first / source_.rays_per_point(), 1, std::move(bulk));
        if (!frames) return tl::unexpected(TraceFailure(frames.error()));
        statistics_.add(chunk.backend, traced->traversals, counts);
        answered(chunk, chunk.count);
        return std::move(*frames);
    }
};

/// Maximum rays of visible_pixels: all""")
    tree.edit("server/jobs/reduce_job.cpp", r"^Reply<std::unique_ptr<QueryJob>> make_visible_pixels", """\
Reply<std::unique_ptr<QueryJob>> make_miss_fraction(const Services& services, const Caller& caller, Plan plan,
                                                    RaySource source, std::string_view reduce) {
    if (!source.has_points() || plan.csr()) return refuse_use(reduce, "is per point, of kind any");
    return std::make_unique<MissJob>(services, caller, std::move(plan), std::move(source));
}

Reply<std::unique_ptr<QueryJob>> make_visible_pixels""")


def add_kernels(tree):
    """An intersector that sees even triangles alone, and a primitive."""
    tree.add_row("engine/intersectors/intersectors.def", "RAYNEST_INTERSECTOR(alpha_mask",
                 ("alpha_mask, AlphaMask",), ("even_triangles, EvenTriangles",))
    (tree.root / "engine/intersectors/even_triangles.h").write_text("""\
#pragma once

#include "engine/intersectors/interface.h"

namespace raynest {

struct EvenTriangles {
    static constexpr const char* text = "sees triangles of even numbers";
    RAYNEST_FN auto operator()(const auto& ray, const TriangleLike auto& triangle) {
        auto hits = intersect(ray, triangle);
        hits.keep_if([](const Surface& surface) { return surface.prim % 2 == 0; });
        return hits;
    }
};

}  // namespace raynest
""")
    tree.add_row("engine/geometry/primitives.def", "RAYNEST_PRIMITIVE(sphere", ("sphere, Sphere",), ("ball, Ball",))
    (tree.root / "engine/geometry/ball.h").write_text("""\
#pragma once

#include "engine/geometry/sphere.h"

namespace raynest {

struct Ball {
    Vec3 center;
    float radius;
};

[[nodiscard]] RAYNEST_FN inline Box bounds(const Ball& ball) {
    return bounds(Sphere{ball.center, ball.radius});
}

template <class R>
RAYNEST_INLINE auto intersect(const R& ray, const Ball& ball) {
    auto hits = no_hits<1>(ball);
    const float t = glm::dot(ball.center - ray.origin, ray.direction);
    if (t > 0) add_hit(hits, 0, t, 0, 0, true);
    return hits;
}

}  // namespace raynest
""")


def add_backend(tree):
    """It refuses all jobs."""
    tree.add_row("protocol/lists/workers.def", "RAYNEST_WORKER(cuda", ("cuda", "the machine's first GPU"), ("idle", "nobody"))
    (tree.root / "server/backends/idle.cpp").write_text("""\
#include "server/backends/backends.h"
#include "server/execution/plan.h"

namespace raynest::server {
namespace {

class Idle final : public Backend {
public:
    [[nodiscard]] std::string_view name() const override { return "idle"; }
    [[nodiscard]] std::string title() const override { return "the idle worker"; }
    [[nodiscard]] std::string target(const Plan&) const override { return "none"; }
    [[nodiscard]] std::optional<Unavailable> unavailable_reason(const Plan&) override {
        return Unavailable{"it does nothing"};
    }
    [[nodiscard]] std::uint64_t call_rays_max(const Plan&) const override { return 1; }
    Traced<Traversal> trace(const Plan&, const TraceCall&, const PinholeRays*, const Stop&) override {
        return tl::unexpected(TraceFailure(Unavailable{"it does nothing"}));
    }
};

}  // namespace

std::unique_ptr<Backend> make_idle(const BackendContext&) {
    return std::make_unique<Idle>();
}

}  // namespace raynest::server
""")
    tree.edit("server/CMakeLists.txt", r"backends/cuda\.cpp", "backends/cuda.cpp backends/idle.cpp")


def add_request(tree):
    tree.add_row("protocol/lists/requests.def", "RAYNEST_REQUEST(15", ("15", "Stats", "stats", "plain", "Statistics"),
                 ("40", "Echo", "echo", "checked", "Echoed"))
    tree.add_row("protocol/lists/requests.def", "RAYNEST_ANSWER(130", ("130", "Pong"), ("168", "Echoed"))
    tree.edit("protocol/messages.fbs", r"^// ---- jobs -+$", """\
table Echo { text: string; deadline_ms: uint; }
table Echoed { text: string; }

// ---- jobs""")
    tree.edit("protocol/validate.cpp", r"^Result<void> validate\(const wire::Need&", """\
Result<void> validate(const wire::Echo& message, const Limits& limits) {
    return Checks(limits).needs("text", message.text()).text("text", message.text()).result();
}

Result<void> validate(const wire::Need&""")
    (tree.root / "server/requests/echo.cpp").write_text("""\
#include "server/requests/request.h"

namespace raynest::server {

Reply<Answer> echo(const Services& services, const Caller& caller,
                   const protocol::Opened<wire::Echo>& message) {
    if (protocol::text(message->text()) == "HELLO") return refuse(Code::too_loud, "it shouts");
    wire::EchoedT echoed;
    echoed.text = protocol::text(message->text());
    return answer_with(caller, echoed, services);
}

}  // namespace raynest::server
""")
    tree.edit("server/CMakeLists.txt", r"requests/stats\.cpp", "requests/stats.cpp requests/echo.cpp")


def add_shading(tree):
    """A material that glows by a factor of its own, and a light that shines alike at any distance, as much as a number
    of its own says."""
    (tree.root / "engine/shading/glow.h").write_text("""\
#pragma once

#include "engine/shading/unlit.h"

namespace raynest {

struct Glow : Unlit {
    Glow(const MaterialPoint& point, const Vec3& outgoing) : Unlit(point, outgoing) {
        colour = Vec3(point.layers.glow, 0, 0);
    }
};

}  // namespace raynest
""")
    (tree.root / "engine/shading/even.h").write_text("""\
#pragma once

#include "engine/shading/point.h"

namespace raynest {

struct EvenLight {
    static constexpr bool distant = false;
    static constexpr std::array numbers{LightNumber{"gain", 1, 0, 10}};
    static float power(const LightRecord& light) {
        return light.own[0] * brightness(light.intensity);
    }
    static LightSample sample(const LightRecord& light, const Vec3& from, const Vec2& u) {
        LightSample sample = PointLight::sample(light, from, u);
        sample.radiance = light.own[0] * light.intensity;
        return sample;
    }
};

}  // namespace raynest
""")
    tree.edit("engine/shading/material_layers.def", r"(?m)^#undef RAYNEST_MATERIAL_LAYER$",
              'RAYNEST_MATERIAL_LAYER(RAYNEST_materials_glow, l.glow > 0)\n'
              'RAYNEST_MATERIAL_LAYER_FACTOR(RAYNEST_materials_glow, "glowFactor", float, glow, 0, 0, 10)\n\n'
              '#undef RAYNEST_MATERIAL_LAYER')
    tree.add_row("engine/shading/materials.def", "RAYNEST_MATERIAL(unlit", ("unlit, Unlit",), ("glow, Glow",))
    tree.add_row("engine/shading/lights.def", "RAYNEST_LIGHT(spot", ("spot, SpotLight",), ("even, EvenLight",))


def add_integrator(tree):
    """An integrator with a setting of its own."""
    tree.add_row("engine/integrators/integrators.def", "RAYNEST_INTEGRATOR(direct",
                 ("direct, Direct", "lights and shadows", '"sun"'), ("twice, Twice", "two bounces", '"sun", "turns"'))
    tree.add_row("engine/integrators/integrator_settings.def", "RAYNEST_INTEGRATOR_SETTING(depth",
                 ("depth", "Bounces", '1024, 8, "8"', "most bounces of a path"), ("turns", "Turns", '4, 2, "2"', "how often a path turns"))
    tree.edit("protocol/messages.fbs", r"^}\n\ntable Heatmap {", "  turns: uint;\n}\n\ntable Heatmap {")
    (tree.root / "engine/integrators/twice.h").write_text("""\
#pragma once

#include "engine/integrators/path.h"

namespace raynest {

class Twice final : public Path {
public:
    Twice(const IntegratorScene& scene, const IntegratorSettings& settings)
        : Path(scene, settings, settings.turns) {}
};

}  // namespace raynest
""")


def add_look(tree):
    """A tone map that halves, and a palette."""
    tree.add_row("engine/integrators/tonemaps.def", "RAYNEST_TONEMAP(none", ("none", "clipped at 1"), ("half", "x / 2"))
    tree.edit("engine/integrators/tonemap.cpp", r"^Vec3 none\(", """\
Vec3 half(const Vec3& colour) {
    return 0.5F * colour;
}

Vec3 none(""")
    tree.edit("server/web/tonemap.js", r"^vec3 none\(", "vec3 half(vec3 c) { return 0.5 * c; }\nvec3 none(")
    tree.edit("client/python/raynest/_render.py", "reinhard, none", "reinhard, half, none")
    tree.add_row("engine/integrators/palettes.def", "RAYNEST_PALETTE(gray", ("gray", "0x000000"), ("paper", "0x404040"))


def add_limit(tree):
    tree.add_row("protocol/lists/limits.def", "RAYNEST_LIMIT(total_jobs_max",
                 ("total_jobs_max", "requests in flight of all connections"), ("echoes_max", "echoes at a time"))


def add_command(tree):
    tree.add_row("client/commands/commands.def", "RAYNEST_COMMAND(stats",
                 ('stats, Stats, "stats"', "print the daemon's counters"),
                 ('beat, Stats, "beat"', "say that the daemon answers"))
    (tree.root / "client/commands/beat.cpp").write_text("""\
#include "client/commands/command.h"

#include <iostream>

namespace raynest::client {
namespace {

struct BeatOptions {};

}  // namespace

void declare(CommandLine&, BeatOptions&) {}

Result<void> run(Context& context, const BeatOptions&) {
    const auto reply = ask<wire::Statistics>(context.connection, wire::StatsT{});
    if (!reply) return tl::unexpected<Failure>(reply.error());
    std::cout << "it beats\\n";
    return {};
}

std::unique_ptr<Command> make_beat() {
    return make_command<BeatOptions>();
}

}  // namespace raynest::client
""")


ADDITIONS = (add_counter, add_generator, add_request, add_error, add_reducer, add_shading, add_integrator, add_look, add_limit,
             add_kernels, add_backend, add_command)
