#include "tests/bench/workload.h"

#include "engine/assets/import.h"
#include "engine/integrators/camera.h"
#include "engine/queries/columns.h"
#include "tests/conformance/scenes.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <numbers>

namespace raynest::bench {
namespace {

using conformance::Random;

Result<std::vector<std::byte>> read_file(const std::string& path) {
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    if (!file) return fail(ErrorCode::io_failed, "cannot read " + path);
    std::vector<std::byte> bytes(static_cast<std::size_t>(file.tellg()));
    file.seekg(0);
    file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    return bytes;
}

/// A counted array of `T` as the benchmark formats store it: the size must fit exactly.
template <class T>
Result<std::vector<T>> read_counted(const std::string& path) {
    const auto bytes = read_file(path);
    if (!bytes) return tl::unexpected(bytes.error());
    std::uint32_t count = 0;
    if (bytes->size() >= sizeof count) std::memcpy(&count, bytes->data(), sizeof count);
    if (bytes->size() != sizeof count + std::size_t{count} * sizeof(T)) {
        return fail(ErrorCode::scene_invalid, path + " is not a count and that many records");
    }
    std::vector<T> values(count);
    std::memcpy(values.data(), bytes->data() + sizeof count, values.size() * sizeof(T));
    return values;
}

Result<SceneDescription> describe_soup(const std::string& path) {
    const auto vertices = read_counted<std::array<Vec3, 3>>(path);
    if (!vertices) return tl::unexpected(vertices.error());
    SceneDescription scene;
    GeometryDescription geometry;
    for (const auto& triangle : *vertices) {
        for (const Vec3& v : triangle) {
            geometry.indices.push_back(static_cast<std::uint32_t>(geometry.positions.size()));
            geometry.positions.push_back(v);
        }
    }
    scene.objects.emplace_back().geometries.push_back(std::move(geometry));
    return scene;
}

Result<SceneDescription> describe_source(const std::string& source, const Registry& registry) {
    if (source.ends_with(".soup")) return describe_soup(source);
    ImportRequest request{source, {}, ""};
    std::vector<std::byte> main_file;
    if (!source.starts_with("builtin:")) {
        auto bytes = read_file(source);
        if (!bytes) return tl::unexpected(bytes.error());
        main_file = std::move(*bytes);
        request.source = std::filesystem::path(source).filename();
        request.files.push_back({request.source, main_file});
    }
    return describe(request, ImportLimits{}, registry);
}

// A direction around n with density cos / pi (Malley's method).
Vec3 cosine_direction(const Vec3& n, Random& random) {
    const float r = std::sqrt(random.unit());
    const float phi = 2 * std::numbers::pi_v<float> * random.unit();
    const Vec3 helper = std::abs(n.x) < 0.5F ? Vec3(1, 0, 0) : Vec3(0, 1, 0);
    const Vec3 x = glm::normalize(glm::cross(helper, n));
    const Vec3 y = glm::cross(n, x);
    return r * std::cos(phi) * x + r * std::sin(phi) * y + std::sqrt(std::max(0.0F, 1 - r * r)) * n;
}

// A camera's rays in 8 x 8 tiles: 64 rays in a row look in nearly the same direction.
std::vector<Ray> primary_rays(const Workload& workload, std::uint32_t count) {
    const auto camera = choose_camera(*workload.scene, {});
    const auto height =
        static_cast<std::uint32_t>(std::sqrt(static_cast<float>(count) * 9 / 16) / 8) * 8;
    const std::uint32_t width = count / height / 8 * 8;
    std::vector<Ray> rows(std::size_t{width} * height);
    generate_rays(*camera, width, height, 0, rows);
    std::vector<Ray> tiles;
    tiles.reserve(rows.size());
    for (std::uint32_t ty = 0; ty < height; ty += 8) {
        for (std::uint32_t tx = 0; tx < width; tx += 8) {
            for (std::uint32_t i = 0; i < 64; ++i) {
                tiles.push_back(rows[std::size_t{ty + i / 8} * width + tx + i % 8]);
            }
        }
    }
    for (Ray& ray : tiles) ray.direction = glm::normalize(ray.direction);
    return tiles;
}

std::vector<Ray> random_rays(const Box& box, std::uint32_t count, Random& random) {
    std::vector<Ray> rays(count);
    for (Ray& ray : rays) {
        for (int axis = 0; axis < 3; ++axis) {
            ray.origin[axis] = random.between(box.lower[axis], box.upper[axis]);
        }
        ray.direction = random.direction();
    }
    return rays;
}

}  // namespace

Result<Workload> load_workload(const std::string& source, const Registry& registry) {
    auto description = describe_source(source, registry);
    if (!description) return tl::unexpected(description.error());
    auto scene = Snapshot::bake(*description);
    if (!scene) return tl::unexpected(scene.error());
    return Workload{std::filesystem::path(source).stem(), std::move(*description), *scene};
}

Result<RayKind> parse_ray_kind(const std::string& name) {
    if (name == "primary") return RayKind::primary;
    if (name == "ao") return RayKind::ao;
    if (name == "diffuse") return RayKind::diffuse;
    if (name == "random") return RayKind::random;
    return fail(ErrorCode::param_invalid,
                "unknown ray kind '" + name + "': use primary, ao, diffuse or random");
}

std::vector<Ray> make_rays(const Workload& workload, RayKind kind, std::uint32_t count,
                           TraceFunction trace) {
    Random random(17);
    const Box& box = workload.scene->bounds();
    if (kind == RayKind::random) return random_rays(box, count, random);
    const std::vector<Ray> primary = primary_rays(workload, count);
    if (kind == RayKind::primary) return primary;

    const auto n = static_cast<std::uint32_t>(primary.size());
    std::vector<HitRecord> hits(n);
    const SceneView& view = workload.scene->view();
    const TraceCall call{&view, nullptr,     primary.data(), n,       1,      0xFFFFFFFFU,
                         0,     hits.data(), nullptr,        nullptr, nullptr};
    trace(&call);
    ColumnSource source;
    source.scene = &view;
    const float reach = glm::length(box.size());
    std::vector<Ray> rays;
    for (std::uint32_t i = 0; i < n; ++i) {
        if (hits[i].hit == 0) continue;
        Vec3 normal = world_normal(source, primary[i], hits[i]);
        if (glm::dot(normal, primary[i].direction) > 0) normal = -normal;
        if (!(glm::length(normal) > 0.5F)) continue;
        Ray ray;
        ray.origin = primary[i].origin + hits[i].t * primary[i].direction + 1e-4F * reach * normal;
        ray.direction = glm::normalize(cosine_direction(normal, random));
        if (kind == RayKind::ao) ray.tmax = 0.05F * reach;
        rays.push_back(ray);
    }
    return rays;
}

Result<std::vector<Ray>> load_rays(const std::string& path) {
    return read_counted<Ray>(path);
}

}  // namespace raynest::bench
