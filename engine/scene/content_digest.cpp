#include "engine/scene/content_digest.h"

#include "engine/scene/format.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <mutex>
#include <numeric>
#include <string_view>
#include <type_traits>
#include <unordered_map>
#include <utility>

namespace raynest {
namespace {

using format::Section;

/// Instances whose bytes are hashed together: an edit of one hashes all of them. Of more runs than
/// this, the digests are hashed in runs again.
constexpr std::uint32_t run_instances = 512;
constexpr std::size_t piece_elements = 4096;
constexpr std::size_t short_name = 64;
constexpr std::size_t changed_objects_max = 256;

/// Bytes that are hashed together.
class Text {
public:
    explicit Text(std::string_view kind) { add(kind); }

    template <class T>
    requires std::is_trivially_copyable_v<T>
    void add(const T& number) {
        static_assert(!std::is_pointer_v<T>);
        add_bytes(&number, sizeof number);
    }
    void add(std::string_view text) {
        add(std::uint64_t{text.size()});
        add_bytes(text.data(), text.size());
    }
    void add(std::span<const Sha256> digests) {
        add(std::uint64_t{digests.size()});
        add_bytes(digests.data(), digests.size_bytes());
    }
    [[nodiscard]] std::span<const std::byte> bytes() const { return bytes_; }

private:
    void add_bytes(const void* first, std::size_t count) {
        const auto* const begin = static_cast<const std::byte*>(first);
        bytes_.insert(bytes_.end(), begin, begin + count);
    }
    std::vector<std::byte> bytes_;
};

}  // namespace

/// Hashes parts of one scene. Any number of threads may call it.
class ContentDigests::Hasher {
public:
    explicit Hasher(const CheckedArena& scene)
        : scene_(scene),
          paths_(format::path_table(scene.bytes.data())),
          has_nodes_(paths_.node_count != 0),
          bytes_left_(static_cast<std::int64_t>(
              format::section_size(scene.bytes.data(), Section::attributes))),
          name_bytes_left_(
              static_cast<std::int64_t>(format::section_size(scene.bytes.data(), Section::names))) {
    }

    /// Fails if anything did.
    [[nodiscard]] Result<void> state() const {
        if (broken_) return no_sha256();
        if (bytes_left_ < 0)
            return fail(ErrorCode::scene_invalid,
                        "the scene arena is broken: runs of attributes overlap");
        if (name_bytes_left_ < 0)
            return fail(ErrorCode::scene_invalid, "the scene arena is broken: names overlap");
        return {};
    }

    Sha256 sum(const Text& text) { return sum(text.bytes()); }

    std::vector<Sha256> materials() {
        std::map<std::uint64_t, Sha256> planes;  // textures of one image share its plane
        std::vector<Sha256> textures;
        for (std::uint32_t i = 0; i < view().texture_count; ++i) {
            const TextureRecord& texture = view().textures[i];
            const std::uint64_t bytes = 4 * std::uint64_t{texture.width} * texture.height;
            const auto [plane, is_new] = planes.try_emplace(texture.colour);
            if (is_new) plane->second = attributes<std::byte>(texture.colour, bytes);
            Text text("texture");
            text.add(plane->second);
            text.add(texture.width), text.add(texture.height);
            text.add(texture.wrap_s), text.add(texture.wrap_t), text.add(texture.nearest);
            text.add(scene_.shading.levels[i].linear);
            textures.push_back(sum(text));
        }
        const auto digest_of = [&](std::uint32_t texture) {
            return texture == no_id ? Sha256{} : textures[texture];
        };
        std::vector<Sha256> materials;
        for (std::uint32_t i = 0; i < view().material_count; ++i) {
            MaterialRecord material = view().materials[i];
            SurfaceRecord surface = scene_.shading.surfaces[i];
            Text text("material");
            add_name(text, material.name);
            text.add(digest_of(material.texture));
            for (TextureUse& use : surface.textures) {
                text.add(digest_of(use.texture));
                use.texture = 0;
            }
            material.name = material.texture = 0;
            text.add(material), text.add(surface);
            materials.push_back(sum(text));
        }
        return materials;
    }

    Sha256 primitives(const ObjectRecord& object, std::span<const Sha256> materials) {
        Text text("object");
        add_name(text, object.name);
        text.add(object.record_type), text.add(object.record_size), text.add(object.record_count);
        if (object.record_count != 0) text.add(records(object));
        for (std::uint32_t i = 0; i < object.geometry_count; ++i) {
            const std::uint32_t number = object.first_geometry + i;
            const GeometryRecord& geometry = view().geometries[number];
            const GeometryShading& shading = scene_.shading.geometries[number];
            const std::uint64_t vertices = geometry.vertex_count;
            text.add(geometry.triangle_count), text.add(geometry.vertex_count);
            text.add(geometry.material == no_id ? Sha256{} : materials[geometry.material]);
            text.add(attributes<float>(geometry.positions, 3 * vertices));
            text.add(attributes<std::uint32_t>(geometry.indices,
                                               std::uint64_t{3} * geometry.triangle_count));
            for (const std::uint64_t set : geometry.texcoords)
                text.add(attributes<float>(set, 2 * vertices));
            text.add(attributes<std::uint32_t>(geometry.colours, vertices));
            text.add(attributes<float>(shading.normals, 3 * vertices));
            text.add(attributes<float>(shading.tangents, 4 * vertices));
        }
        return sum(text);
    }

    /// Hashes instances and what was hashed of them; `stale` are the runs that have changed,
    /// ascending.
    template <class Below>
    void set_runs(const ObjectRecord& record, ObjectDigests& object,
                  std::span<const std::size_t> stale, const Below& below) {
        tbb::parallel_for(std::size_t{0}, stale.size(),
                          [&](std::size_t i) { set_run(record, stale[i], object, below); });
        Text text("whole object");
        text.add(object.primitives);
        text.add(object.runs.size() <= run_instances ? object.runs : long_runs(object, stale));
        object.whole = sum(text);
    }

    Sha256 rest(std::span<const Sha256> materials) {
        const auto& header = *reinterpret_cast<const format::Header*>(scene_.bytes.data());
        Text text("rest");
        text.add(header.build), text.add(header.up), text.add(header.origin);
        text.add(header.chosen_variant), text.add(header.variants);
        const auto warnings = format::section_size(scene_.bytes.data(), Section::warnings);
        const auto* const names = section<format::NameOffset>(Section::warnings);
        for (std::uint64_t i = warnings - header.variants; i < warnings; ++i)
            add_name(text, names[i]);
        text.add(materials);
        const auto motion = format::section_size(scene_.bytes.data(), Section::motion);
        text.add(motion), text.add(long_run(section<std::byte>(Section::motion), motion));
        add_paths(text);
        return sum(text);
    }

    Sha256 cameras() {
        Text text("cameras");
        for (std::uint32_t i = 0; i < view().camera_count; ++i) {
            CameraRecord camera = view().cameras[i];
            add_name(text, camera.name);
            camera.name = 0;
            text.add(camera);
        }
        return sum(text);
    }

    Sha256 lights() {
        Text text("lights");
        for (std::uint32_t i = 0; i < scene_.shading.light_count; ++i) {
            LightRecord light = scene_.shading.lights[i];
            add_name(text, light.name);
            light.name = 0;
            text.add(light);
        }
        return sum(text);
    }

private:
    template <class Below>
    void set_run(const ObjectRecord& record, std::size_t number, ObjectDigests& object,
                 const Below& below) {
        const auto first = static_cast<std::uint32_t>(number) * run_instances;
        const std::uint32_t end = std::min(first + run_instances, record.instance_count);
        Text text("instances");
        const std::uint32_t* const numbers = paths_.numbers;
        for (std::uint32_t i = record.first_instance + first; i < record.first_instance + end;
             ++i) {
            const InstanceInfo& info = view().instance_infos[i];
            // Where there are nodes, these have the user ids and the numbers.
            text.add(info.to_parent), text.add(has_nodes_ ? 0 : info.uid);
            add_name(text, info.name);
            text.add(numbers == nullptr ? no_id : numbers[i]);
            text.add(info.mask), text.add(below(view().instances[i].object).whole);
        }
        object.runs[number] = sum(text);
    }

    /// Returns the digests of an object's runs in runs of their own.
    const std::vector<Sha256>& long_runs(ObjectDigests& object,
                                         std::span<const std::size_t> stale) {
        object.long_runs.resize((object.runs.size() + run_instances - 1) / run_instances);
        std::size_t last = object.long_runs.size();
        for (const std::size_t run : stale) {
            const std::size_t number = run / run_instances;
            if (std::exchange(last, number) == number) continue;
            const std::size_t first = number * run_instances;
            const std::size_t count =
                std::min<std::size_t>(run_instances, object.runs.size() - first);
            Text text("runs");
            text.add(std::span<const Sha256>(object.runs).subspan(first, count));
            object.long_runs[number] = sum(text);
        }
        return object.long_runs;
    }

    [[nodiscard]] const SceneView& view() const { return scene_.view; }
    template <class T>
    [[nodiscard]] const T* section(Section which) const {
        return format::section<T>(scene_.bytes.data(), which);
    }

    Sha256 sum(std::span<const std::byte> bytes) {
        Sha256 digest{};
        if (!hash_bytes(bytes, digest)) broken_ = true;
        return digest;
    }

    /// Hashes pieces, each filled by fill(first, end, text), on all threads.
    template <class Fill>
    Sha256 in_pieces(std::size_t count, std::string_view kind, const Fill& fill) {
        std::vector<Sha256> pieces((count + piece_elements - 1) / piece_elements);
        tbb::parallel_for(std::size_t{0}, pieces.size(), [&](std::size_t i) {
            Text text(kind);
            fill(i * piece_elements, std::min(count, (i + 1) * piece_elements), text);
            pieces[i] = sum(text);
        });
        Text text(kind);
        text.add(std::uint64_t{count}), text.add(pieces);
        return sum(text);
    }

    Sha256 long_run(const std::byte* first, std::uint64_t count) {
        if (count <= digest_piece_bytes) return sum(std::span(first, count));
        Sha256 digest{};
        if (!hash_pieces({first, count}, digest)) broken_ = true;
        return digest;
    }

    /// Many instances may have one long name: it is hashed once.
    void add_name(Text& text, std::uint32_t offset) {
        const char* const name = view().names + offset;
        const std::size_t length = ::strnlen(name, short_name + 1);
        if (length <= short_name) return text.add(std::string_view(name, length));
        const std::lock_guard lock(names_mutex_);
        const auto [known, is_new] = long_names_.try_emplace(offset);
        if (is_new) {
            const std::string_view whole(name);
            name_bytes_left_ -= static_cast<std::int64_t>(whole.size());
            if (name_bytes_left_ >= 0) known->second = sum(std::as_bytes(std::span(whole)));
        }
        text.add(known->second);
    }

    /// Zeros for an attribute that is not there.
    template <class T>
    Sha256 attributes(std::uint64_t offset, std::uint64_t count) {
        if (offset == no_offset) return {};
        const std::uint64_t bytes = count * sizeof(T);
        bytes_left_ -= static_cast<std::int64_t>(bytes);
        if (bytes_left_ < 0) return {};
        return long_run(view().attributes + offset, bytes);
    }

    /// The records by their original indices.
    Sha256 records(const ObjectRecord& object) {
        return in_pieces(
            object.record_count, "records", [&](std::size_t first, std::size_t end, Text& text) {
                for (std::size_t i = first; i < end; ++i)
                    text.add(std::string_view(reinterpret_cast<const char*>(view().record_of(
                                                  object, static_cast<std::uint32_t>(i))),
                                              object.record_size));
            });
    }

    void add_paths(Text& text) {
        text.add(in_pieces(paths_.node_count, "path nodes",
                           [&](std::size_t first, std::size_t end, Text& piece) {
                               for (std::size_t i = first; i < end; ++i) {
                                   PathNode node = paths_.nodes[i];
                                   add_name(piece, node.name);
                                   node.name = 0;
                                   piece.add(node);
                               }
                           }));
        text.add(in_pieces(paths_.run_count, "path runs",
                           [&](std::size_t first, std::size_t end, Text& piece) {
                               for (std::size_t i = first; i < end; ++i) piece.add(paths_.runs[i]);
                           }));
    }

    const CheckedArena& scene_;
    const PathTable paths_;
    const bool has_nodes_;
    std::atomic<std::int64_t> bytes_left_;       ///< each byte of the attributes is hashed once
    std::atomic<std::int64_t> name_bytes_left_;  ///< likewise, of long names
    std::mutex names_mutex_;
    std::unordered_map<std::uint32_t, Sha256> long_names_;
    std::atomic<bool> broken_ = false;
};

Result<std::shared_ptr<const ContentDigests>> ContentDigests::of(const CheckedArena& scene) {
    const SceneView& view = scene.view;
    Hasher hasher(scene);
    const auto digests = std::make_shared<ContentDigests>();
    const auto materials = std::make_shared<const std::vector<Sha256>>(hasher.materials());
    digests->materials_ = materials;
    digests->rest_ = hasher.rest(*materials);
    const auto objects = std::make_shared<std::vector<ObjectDigests>>(view.object_count);
    tbb::parallel_for(std::uint32_t{0}, view.object_count, [&](std::uint32_t i) {
        (*objects)[i].primitives = hasher.primitives(view.objects[i], *materials);
    });
    const auto below = [&](std::uint32_t object) -> const ObjectDigests& {
        return (*objects)[object];
    };
    for (std::uint32_t i = 0; i < view.object_count; ++i) {
        const std::size_t runs =
            (view.objects[i].instance_count + run_instances - 1) / run_instances;
        ObjectDigests& object = (*objects)[i];
        object.runs.resize(runs);
        std::vector<std::size_t> all(runs);
        std::iota(all.begin(), all.end(), std::size_t{0});
        hasher.set_runs(view.objects[i], object, all, below);
    }
    if (auto sound = hasher.state(); !sound) return tl::unexpected(sound.error());
    digests->opened_ = objects;
    if (auto set = digests->set_scene(scene); !set) return tl::unexpected(set.error());
    return digests;
}

Result<std::shared_ptr<const ContentDigests>> ContentDigests::after(
    const CheckedArena& edited, const TouchedObjects& touched) const {
    const SceneView& view = edited.view;
    Hasher hasher(edited);
    const auto digests = std::make_shared<ContentDigests>(*this);
    const auto below = [&](std::uint32_t object) -> const ObjectDigests& {
        return digests->at(object);
    };
    // Ascending: an object lies behind those that it places.
    for (const auto& [index, changes] : touched) {
        const ObjectRecord& record = view.objects[index];
        ObjectDigests object = digests->at(index);
        if (changes.primitives) object.primitives = hasher.primitives(record, *materials_);
        std::vector<std::size_t> stale;
        for (const std::uint32_t place : changes.places) stale.push_back(place / run_instances);
        std::ranges::sort(stale);
        const auto doubles = std::ranges::unique(stale);
        stale.erase(doubles.begin(), doubles.end());
        hasher.set_runs(record, object, stale, below);
        digests->changed_[index] = std::make_shared<const ObjectDigests>(std::move(object));
    }
    // Each edit copies the map: what many edits have changed joins the rest now and then.
    if (digests->changed_.size() > changed_objects_max) {
        const auto all = std::make_shared<std::vector<ObjectDigests>>(*opened_);
        for (const auto& [index, object] : digests->changed_) (*all)[index] = *object;
        digests->opened_ = all;
        digests->changed_.clear();
    }
    if (auto sound = hasher.state(); !sound) return tl::unexpected(sound.error());
    if (auto set = digests->set_scene(edited); !set) return tl::unexpected(set.error());
    return digests;
}

Result<void> ContentDigests::set_scene(const CheckedArena& scene) {
    Hasher hasher(scene);
    Text text("scene");
    text.add(std::uint32_t{format::version});
    text.add(rest_), text.add(hasher.cameras()), text.add(hasher.lights());
    text.add(at(scene.view.root).whole);
    const Sha256 whole = hasher.sum(text);
    if (auto sound = hasher.state(); !sound) return sound;
    scene_ = digest_text(whole);
    return {};
}

}  // namespace raynest
