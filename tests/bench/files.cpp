#include "tests/bench/files.h"

#include <array>
#include <cstring>
#include <fstream>
#include <span>
#include <utility>

namespace raynest::bench {
namespace {

using Corners = std::array<Vec3, 3>;
static_assert(sizeof(Corners) == 36 && sizeof(Ray) == 32 && sizeof(Reference) == 12);

tl::unexpected<Error> invalid(const std::string& path, const std::string& what) {
    return fail(ErrorCode::scene_invalid, path + ": " + what);
}

/// Takes records off the front of a file's bytes; false where they end too early.
class Cursor {
public:
    explicit Cursor(std::span<const std::byte> bytes) : rest_(bytes) {}

    template <class T>
    [[nodiscard]] bool take(T& value) {
        if (rest_.size() < sizeof(T)) return false;
        std::memcpy(&value, rest_.data(), sizeof(T));
        rest_ = rest_.subspan(sizeof(T));
        return true;
    }
    /// A u32 count and that many records; nothing is allocated for records that are not there.
    template <class T>
    [[nodiscard]] bool take_counted(std::vector<T>& values) {
        std::uint32_t count = 0;
        if (!take(count) || rest_.size() / sizeof(T) < count) return false;
        values.resize(count);
        if (count != 0) std::memcpy(values.data(), rest_.data(), count * sizeof(T));
        rest_ = rest_.subspan(count * sizeof(T));
        return true;
    }
    [[nodiscard]] bool at_end() const { return rest_.empty(); }

private:
    std::span<const std::byte> rest_;
};

/// A file that is one counted array.
template <class T>
Result<std::vector<T>> read_counted(const std::string& path) {
    const auto bytes = read_file(path);
    if (!bytes) return tl::unexpected(bytes.error());
    Cursor cursor(*bytes);
    std::vector<T> values;
    if (!cursor.take_counted(values) || !cursor.at_end()) {
        return invalid(path, "is not a count and exactly that many records of " +
                                 std::to_string(sizeof(T)) + " bytes");
    }
    return values;
}

/// Triangle i is (3i, 3i + 1, 3i + 2): the index in the file is the primitive's.
GeometryDescription mesh_of(std::span<const Corners> triangles) {
    GeometryDescription mesh;
    mesh.positions.reserve(3 * triangles.size());
    mesh.indices.reserve(3 * triangles.size());
    for (const Corners& corners : triangles) {
        for (const Vec3& corner : corners) {
            mesh.indices.push_back(static_cast<std::uint32_t>(mesh.positions.size()));
            mesh.positions.push_back(corner);
        }
    }
    return mesh;
}

struct FileInstance {
    std::uint32_t kind;
    std::uint32_t child;
    Transform to_parent;
};
static_assert(sizeof(FileInstance) == 56);

Result<InstanceDescription> instance_of(const FileInstance& from, std::uint32_t meshes,
                                        std::uint32_t groups, const std::string& path) {
    if (from.kind > 1 || from.child >= (from.kind == 0 ? meshes : groups)) {
        return invalid(path, "an instance of kind " + std::to_string(from.kind) + " names child #" +
                                 std::to_string(from.child) + ", which does not exist");
    }
    Transform inverse;
    if (!invert(from.to_parent, inverse)) {
        return invalid(path, "an instance has a singular or non-finite matrix");
    }
    InstanceDescription instance;
    instance.object = from.child + (from.kind == 0 ? 0 : meshes);
    instance.transform = from.to_parent;
    return instance;
}

}  // namespace

Result<std::vector<std::byte>> read_file(const std::string& path) {
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    const std::streamoff size = file ? static_cast<std::streamoff>(file.tellg()) : -1;
    if (size < 0) return fail(ErrorCode::io_failed, "cannot read " + path);
    std::vector<std::byte> bytes(static_cast<std::size_t>(size));
    file.seekg(0);
    file.read(reinterpret_cast<char*>(bytes.data()), size);
    if (!file) return fail(ErrorCode::io_failed, "cannot read all of " + path);
    return bytes;
}

Result<SceneDescription> read_soup(const std::string& path) {
    const auto triangles = read_counted<Corners>(path);
    if (!triangles) return tl::unexpected(triangles.error());
    SceneDescription scene;
    scene.objects.emplace_back().geometries.push_back(mesh_of(*triangles));
    return scene;
}

Result<SceneDescription> read_instances(const std::string& path) {
    const auto bytes = read_file(path);
    if (!bytes) return tl::unexpected(bytes.error());
    Cursor cursor(*bytes);
    struct {
        std::uint32_t magic, meshes, groups, root;
    } head{};
    constexpr std::uint32_t magic = 0x53494E52;
    if (!cursor.take(head) || head.magic != magic) return invalid(path, "is no .inst file");
    if (head.root >= head.groups) return invalid(path, "the root group does not exist");

    SceneDescription scene;
    const auto cut = [&] { return invalid(path, "ends before its last mesh or group"); };
    std::vector<Corners> triangles;
    for (std::uint32_t i = 0; i < head.meshes; ++i) {
        if (!cursor.take_counted(triangles)) return cut();
        scene.objects.emplace_back().geometries.push_back(mesh_of(triangles));
    }
    std::vector<FileInstance> instances;
    for (std::uint32_t i = 0; i < head.groups; ++i) {
        if (!cursor.take_counted(instances)) return cut();
        ObjectDescription& group = scene.objects.emplace_back();
        for (const FileInstance& from : instances) {
            auto instance = instance_of(from, head.meshes, head.groups, path);
            if (!instance) return tl::unexpected(instance.error());
            group.instances.push_back(std::move(*instance));
        }
    }
    if (!cursor.at_end()) return invalid(path, "has bytes behind its last group");
    scene.root = head.meshes + head.root;
    return scene;
}

Result<std::vector<Ray>> read_rays(const std::string& path) {
    auto rays = read_counted<Ray>(path);
    if (!rays) return rays;
    for (std::size_t i = 0; i < rays->size(); ++i) {
        if (!is_valid((*rays)[i])) return invalid(path, "ray " + std::to_string(i) + " is invalid");
    }
    return rays;
}

Result<std::vector<Reference>> read_references(const std::string& path) {
    auto references = read_counted<Reference>(path);
    if (!references) return references;
    for (std::size_t i = 0; i < references->size(); ++i) {
        if (!((*references)[i].t >= 0)) {
            return invalid(path, "t of ray " + std::to_string(i) + " is negative or no number");
        }
    }
    return references;
}

}  // namespace raynest::bench
