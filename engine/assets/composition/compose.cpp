#include "engine/assets/composition/compose.h"

#include "engine/assets/composition/animate.h"
#include "engine/assets/composition/matrix_table.h"
#include "engine/assets/composition/read.h"
#include "engine/assets/formats/obj_names.h"
#include "engine/assets/input/messages.h"
#include "engine/assets/input/uploaded_files.h"
#include "engine/geometry/moved_box.h"
#include "engine/scene/camera_pose.h"
#include "engine/scene/edits/edit.h"
#include "engine/scene/edits/link.h"
#include "engine/scene/edits/linked_paths.h"
#include "engine/scene/edits/materials.h"
#include "engine/scene/edits/names.h"
#include "engine/scene/precision.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <numbers>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace raynest {
namespace {

using composition::Camera;
using composition::Change;
using composition::Composition;
using composition::Object;
using composition::Places;
using Scene = std::shared_ptr<const Snapshot>;

Matrix less(const WorldPoint& origin) {
    return translation_by({-origin[0], -origin[1], -origin[2]});
}

/// The files of one composition and of those within it, each way to read one once.
class Files {
public:
    Files(const ImportRequest& request, const ImportFile& import_file)
        : request_(request),
          import_file_(import_file) {}

    [[nodiscard]] const NamedBytes* find(std::string_view name) const {
        const auto file = std::ranges::find(request_.files, name, &NamedBytes::name);
        return file == request_.files.end() ? nullptr : &*file;
    }

    /// Imports the file `name` as `object` says, with the files in its folder.
    Result<Scene> import(const std::string& name, const Object& object) {
        const FileOptions& o = object.options;
        const std::string key =
            fmt::format("{}\n{}\n{}\n{}\n{} {} {} {} {} {} {}\n{}", name, object.primitive,
                        object.variant, object.mesh, o.unit, o.radius, o.spacing, o.z_up,
                        o.auto_origin, fmt::join(object.origin, " "), fmt::join(object.at, " "),
                        fmt::join(object.masks, "\n"));
        if (const auto known = known_.find(key); known != known_.end()) return known->second;
        ImportRequest request{name, {}, object.primitive, request_.build, object.origin, {}, o, {}};
        request.stands_at = object.at;
        request.masks = object.masks;
        request.variant = object.variant;
        request.mesh = object.mesh;
        const std::size_t folder = name.rfind('/') + 1;
        if (const NamedBytes* const main = find(name)) {
            request.source = name.substr(folder);
            request.files.push_back({request.source, main->bytes});
            // A second file beside another kind would say where its content is placed.
            const bool names_others = is_gltf(name) || has_extension(name, ".obj");
            for (const NamedBytes& file : request_.files)
                if (names_others && &file != main && file.name.starts_with(name.substr(0, folder)))
                    request.files.push_back({file.name.substr(folder), file.bytes});
        }
        auto built = import_file_(request);
        if (!built) return tl::unexpected(built.error());
        auto scene = Snapshot::open(std::move(*built));
        if (scene) known_.emplace(key, *scene);
        return scene;
    }
    struct Composed {
        Scene scene;            ///< null until it is made
        std::size_t depth = 1;  ///< compositions, one within the other, itself included
    };
    /// The scene of the composition `name`. Objects that name the same one share it: made for each
    /// object, N of them in every file would be N^8 at the deepest level.
    [[nodiscard]] Composed& composed(const std::string& name, const WorldPoint& origin) {
        return composed_[{name, origin}];
    }
    [[nodiscard]] BuildQuality build() const { return request_.build; }
    /// True if the scene that is loaded has an origin: then objects have coordinates of their own.
    [[nodiscard]] bool has_origin() const { return has_origin_; }
    void set_has_origin(bool has_origin) { has_origin_ = has_origin; }

private:
    bool has_origin_ = false;
    const ImportRequest& request_;
    const ImportFile& import_file_;
    std::map<std::string, Scene> known_;
    std::map<std::pair<std::string, WorldPoint>, Composed> composed_;
};

/// Puts one composition together; those within it have composers of their own.
class Composer {
public:
    /// `name` is that of its file, and `above` are the compositions that it lies in, itself last.
    Composer(Files& files, const ImportLimits& limits, std::string name,
             std::vector<std::string> above)
        : files_(files),
          limits_(limits),
          name_(std::move(name)),
          above_(std::move(above)) {}

    Result<BuiltArena> compose(std::span<const std::byte> bytes, const WorldPoint& origin) {
        auto read =
            composition::read({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, limits_);
        if (!read) return tl::unexpected(read.error());
        composition_ = std::move(*read);
        if (origin != WorldPoint{} && composition_.origin != WorldPoint{})
            return fail(ErrorCode::scene_invalid,
                        "has an 'origin' of its own: load it without one, or take it out");
        if (origin != WorldPoint{}) composition_.origin = origin;
        if (!is_origin(composition_.origin))
            return fail(ErrorCode::scene_invalid, "has an 'origin' beyond 1e15");
        if (above_.size() == 1) files_.set_has_origin(composition_.origin != WorldPoint{});
        made_.resize(composition_.objects.size());
        for (std::size_t i = 0; i < composition_.objects.size(); ++i)
            numbers_.emplace(composition_.objects[i].name, i);
        auto made = group(composition_.objects.back(), true);
        if (!made || composition_.edits.empty()) return made;
        return edited(std::move(*made));
    }

private:
    struct Made {
        Scene scene;
        bool is_open = false;  ///< being made: to need it again means that it holds itself
    };

    /// The scene of an object, made when it is first needed.
    Result<Scene> scene_of(const std::string& name) {
        const std::size_t number = numbers_.at(name);
        Made& made = made_[number];
        const Object& object = composition_.objects[number];
        if (made.scene) return made.scene;
        if (std::exchange(made.is_open, true))
            return fail(ErrorCode::scene_invalid,
                        fmt::format("the object '{}' holds itself", one_line(name)));
        if (groups_open_ == scene_depth_max)
            return fail(ErrorCode::limit_exceeded,
                        fmt::format("groups nest deeper than {} levels", scene_depth_max));
        ++groups_open_;
        auto scene =
            object.source.empty() ? group(object, false).and_then(Snapshot::open) : file(object);
        --groups_open_;
        made_[number].is_open = false;
        if (scene) made_[number].scene = *scene;
        return scene;
    }

    Result<Scene> file(const Object& object) {
        const auto blame = [&](const Error& error) {
            return fail(error.code,
                        fmt::format("object '{}': {}", one_line(object.name), error.message));
        };
        if (object.source.starts_with("builtin:")) {
            auto scene = files_.import(object.source, object);
            return scene ? scene : blame(scene.error());
        }
        const auto name = file_of_name(name_, object.source);
        if (!name)
            return blame({ErrorCode::scene_invalid,
                          fmt::format("'{}' is no file beneath the composition's folder",
                                      one_line(object.source))});
        const NamedBytes* const bytes = files_.find(*name);
        if (bytes == nullptr)
            return blame(
                {ErrorCode::scene_invalid, fmt::format("there is no file '{}'", one_line(*name))});
        auto scene = is_composition(*name) ? nested(*bytes, object)
                                           : files_.import(*name, with_up(*name, object));
        return scene ? scene : blame(scene.error());
    }

    /// A file that does not say which of its axes points up has the composition's; glTF says it.
    [[nodiscard]] Object with_up(const std::string& name, const Object& object) const {
        Object made = object;
        if (!object.has_up && !is_gltf(name)) made.options.z_up = composition_.up == UpAxis::z;
        return made;
    }

    Result<Scene> nested(const NamedBytes& file, const Object& object) {
        if (object.options != FileOptions{} || !object.primitive.empty() || !object.masks.empty() ||
            !object.variant.empty() || object.at != WorldPoint{})
            return fail(ErrorCode::scene_invalid,
                        "is a composition, which says itself how to read its files");
        if (std::ranges::find(above_, file.name) != above_.end())
            return fail(ErrorCode::scene_invalid,
                        fmt::format("'{}' holds itself", one_line(file.name)));
        Files::Composed& made = files_.composed(file.name, object.origin);
        if (above_.size() + made.depth > compositions_nested_max)
            return fail(ErrorCode::limit_exceeded,
                        fmt::format("compositions nest deeper than {}", compositions_nested_max));
        if (!made.scene) {
            std::vector<std::string> above = above_;
            above.push_back(file.name);
            Composer composer(files_, limits_, file.name, std::move(above));
            auto scene = composer.compose(file.bytes, object.origin).and_then(Snapshot::open);
            if (!scene) return scene;
            made = {*scene, composer.depth_};
        }
        depth_ = std::max(depth_, made.depth + 1);
        return made.scene;
    }

    /// The map from the coordinates of a part to those that are placed: in the world, and up.
    [[nodiscard]] Matrix to_group(const Snapshot& part) const {
        return turn_of(part.up(), composition_.up) * translation_by(part.origin());
    }

    Result<std::vector<Matrix>> matrices_of(const Places& places) {
        if (places.table.empty()) return places.matrices;
        const auto name = file_of_name(name_, places.table);
        const NamedBytes* const file = name ? files_.find(*name) : nullptr;
        if (file == nullptr)
            return fail(ErrorCode::scene_invalid,
                        fmt::format("there is no file '{}' beneath the composition's folder",
                                    one_line(places.table)));
        return composition::read_matrices(*file, limits_);
    }

    /// Origin of a group, or of a composition within another: where its largest part has its own
    /// zero, or, if that part lies far from there for its size, its middle. A wide part has its
    /// zero where it needs its digits, and rays would lose these on their way through the group.
    Result<WorldPoint> near_parts(const Object& object) {
        constexpr double far = 16;
        glm::dvec3 zero(0);
        double largest = -1;
        std::uint64_t count = 0;
        for (const Places& places : object.instances) {
            const auto scene = scene_of(places.object);
            if (!scene) return tl::unexpected(scene.error());
            const auto matrices = matrices_of(places);
            if (!matrices) return tl::unexpected(matrices.error());
            if (count += matrices->size(); count > limits_.instances_max) return WorldPoint{};
            const Box& box = (*scene)->bounds();
            if (box.is_empty()) continue;
            const glm::dvec3 low(box.lower), high(box.upper), middle = (low + high) / 2.0;
            const bool is_far = glm::length(middle) > far * glm::length(high - low);
            for (const Matrix& matrix : *matrices) {
                const Matrix placed = matrix * to_group(**scene);
                const glm::dvec3 sides = glm::dmat3(placed) * (high - low);
                const glm::dvec3 at(placed * glm::dvec4(is_far ? middle : glm::dvec3(0), 1));
                if (!(glm::length(sides) > largest) || !is_origin({at.x, at.y, at.z})) continue;
                largest = glm::length(sides);
                zero = at;
            }
        }
        return WorldPoint{std::round(zero.x), std::round(zero.y), std::round(zero.z)};
    }

    /// Puts the instances of a group into one scene.
    Result<BuiltArena> group(const Object& object, bool is_scene) {
        std::vector<AddedScene> added;
        SceneDescription base;
        base.build = files_.build();
        base.objects.push_back({object.name, {}, {}, {}, {}, {}, {}});
        if (is_scene) base.origin = composition_.origin;
        // Edits are in the coordinates that the composition itself has.
        const bool is_part = !is_scene || (above_.size() > 1 && composition_.edits.empty());
        if (base.origin == WorldPoint{} && is_part && files_.has_origin()) {
            const auto origin = near_parts(object);
            if (!origin) return tl::unexpected(origin.error());
            base.origin = *origin;
        }
        base.up = composition_.up;
        composition::Animator animator;
        bool has_nodes = false;
        Box bounds;
        std::uint64_t count = 0;
        const auto entries = object.entries_by_name();
        for (const Places& places : object.instances) {
            auto scene = scene_of(places.object);
            if (!scene) return tl::unexpected(scene.error());
            const auto matrices = matrices_of(places);
            if (!matrices) return tl::unexpected(matrices.error());
            if (matrices->empty()) continue;
            // Many entries may name one table.
            if (count += matrices->size(); count > limits_.instances_max)
                return fail(ErrorCode::limit_exceeded,
                            fmt::format("object '{}' has over {} instances; make groups of them",
                                        one_line(object.name), limits_.instances_max));
            has_nodes |= (*scene)->paths().node_count != 0 || places.uid != no_id;
            AddedScene part{*scene, path_step_text(places.name), {}, {}, places.uid};
            part.is_numbered = entries.at(places.name) > 1;
            for (const Matrix& matrix : *matrices) {
                const Matrix placed = less(base.origin) * matrix * to_group(**scene);
                part.to_scene.push_back(transform_of(placed));
                part.masks.push_back(places.mask);
                // The translation of a part with an origin is round, unlike what lies in it.
                const Box& box = (*scene)->bounds();
                const bool is_near_zero = (*scene)->origin() == WorldPoint{} || box.is_empty();
                const glm::dvec3 at =
                    is_near_zero ? glm::dvec3(placed[3])
                                 : glm::dvec3(placed * glm::dvec4(glm::dvec3(box.lower), 1));
                const glm::dvec3 moved = glm::dvec3(Vec3(at)) - at;
                base.rounding = std::max(base.rounding, glm::length(moved));
                bounds.extend(moved_box((*scene)->bounds(), part.to_scene.back()));
            }
            take_along(part, places, *matrices, base);
            if ((*scene)->statistics().instances == 0) continue;
            animator.add(places, matrices->size(), to_group(**scene));
            added.push_back(std::move(part));
        }
        if (is_scene) {
            for (const Camera& camera : composition_.cameras) add_camera(camera, base);
            for (const auto& light : composition_.lights) add_light(light, base);
        }
        if (has_nodes)
            if (auto fits = check_names(added); !fits) return tl::unexpected(fits.error());
        if (has_nodes) base.path_nodes.push_back({0, base.objects[0].name, 0, 0});
        if (auto text = rounding_warning(base, bounds); !text.empty())
            base.warnings.push_back(std::move(text));
        const auto empty = Snapshot::build(base);
        if (!empty) return tl::unexpected(empty.error());
        auto motion = is_scene ? animator.tables(composition_.animations, base.origin)
                               : std::vector<std::byte>();
        if (!motion) return tl::unexpected(motion.error());
        auto linked = link_scenes(**empty, {}, added, {}, std::move(*motion));
        if (!linked && linked.error().code == ErrorCode::field_invalid)
            return fail(ErrorCode::scene_invalid, linked.error().message);
        if (!linked) return linked;
        linked->edits = {};
        std::set<const Snapshot*> parts;
        for (const AddedScene& part : added)
            if (parts.insert(part.scene.get()).second)
                linked->build_seconds += part.scene->statistics().build_seconds;
        return linked;
    }

    /// Makes the composition's edits, one after the other, in what its instances gave.
    Result<BuiltArena> edited(BuiltArena built) {
        using What = Change::What;
        const double seconds = built.build_seconds;
        const auto scene = Snapshot::open(std::move(built));
        if (!scene) return tl::unexpected(scene.error());
        EditBatch batch(**scene);
        InstanceFinder finder(**scene, [] { return false; });
        for (std::size_t i = 0; i < composition_.edits.size(); ++i) {
            const Change& change = composition_.edits[i];
            const auto blame = [&](const Error& error) {
                const bool is_limit = error.code == ErrorCode::limit_exceeded;
                return fail(is_limit ? error.code : ErrorCode::scene_invalid,
                            fmt::format("edits[{}]: {}", i, error.message));
            };
            const auto places = finder.find(change.path);
            if (!places) return blame(places.error());
            std::uint32_t material = no_id;
            if (change.what == What::set_material) {
                const auto found = find_material((*scene)->view(), change.material);
                if (!found) return blame(found.error());
                material = *found;
            }
            for (const InstancePlace& place : *places) {
                Result<void> done;
                if (change.what == What::move) batch.move(place, change.matrix, change.frame);
                if (change.what == What::place)
                    done = batch.place(place, change.matrix, change.frame);
                if (change.what == What::set_mask) batch.set_mask(place, change.value);
                if (change.what == What::set_uid) batch.set_uid(place, change.value);
                if (change.what == What::set_material) done = batch.set_material(place, material);
                if (change.what == What::remove) done = batch.remove(place);
                if (!done) return blame(done.error());
            }
        }
        const auto made = edit_scene(**scene, batch.changes());
        if (!made && made.error().code == ErrorCode::field_invalid)
            return fail(ErrorCode::scene_invalid, "its edits: " + made.error().message);
        if (!made) return tl::unexpected(made.error());
        return BuiltArena{(*made)->copy_arena(), seconds, {}};
    }

    /// Each placement of a part whose paths are named has names of its own.
    Result<void> check_names(const std::vector<AddedScene>& added) {
        std::uint64_t nodes = 0;
        for (const AddedScene& part : added) {
            nodes += nodes_of_copy(*part.scene) * part.to_scene.size();
            if (nodes > limits_.nodes_max)
                return fail(
                    ErrorCode::limit_exceeded,
                    fmt::format("its instances have over {} named nodes: join nodes of '{}', "
                                "or place it less often",
                                limits_.nodes_max, one_line(part.name)));
        }
        return {};
    }

    /// Adds the cameras, lights and warnings of a part to the scene that it becomes part of.
    void take_along(const AddedScene& part, const Places& places,
                    const std::vector<Matrix>& matrices, SceneDescription& base) {
        const Snapshot& scene = *part.scene;
        const SceneView& view = scene.view();
        const auto warn = [&](const std::string& text) {
            constexpr std::size_t most = scene_warnings_max - 1;  // one of the whole comes last
            if (base.warnings.size() + 1 < most)
                base.warnings.push_back(fmt::format("{}: {}", one_line(places.name), text)
                                            .substr(0, scene_name_bytes_max));
            else if (base.warnings.size() < most)
                base.warnings.emplace_back("more warnings are left out");
        };
        if (warned_.insert(places.object).second)
            for (const std::string& text : scene.statistics().warnings) warn(text);
        for (const auto& [reason, count] : scene.statistics().skipped)
            base.skipped[reason] += count * matrices.size();
        if (!scene.motion_bytes().empty())
            warn("its animations are left out: only a file that is loaded by itself plays them");
        const std::uint32_t lights = scene.shading().light_count;
        if (matrices.size() != 1) {
            if (lights != 0)
                warn(fmt::format("its lights are left out, for it stands at {} places",
                                 matrices.size()));
            return;
        }
        const Matrix placed = less(base.origin) * matrices[0] * to_group(scene);
        for (std::uint32_t i = 0; i < view.camera_count; ++i) {
            const CameraRecord& camera = view.cameras[i];
            base.cameras.push_back({fmt::format("{}/{}", places.name, view.names + camera.name),
                                    transform_of(placed * matrix_of(camera.to_world)), camera.yfov,
                                    camera.aspect, camera.ymag});
        }
        for (std::uint32_t i = 0; i < lights; ++i) {
            LightRecord light = scene.shading().lights[i];
            const glm::dmat3 turn(placed);
            light.position = Vec3(placed * glm::dvec4(glm::dvec3(light.position), 1));
            light.direction = Vec3(glm::normalize(turn * glm::dvec3(light.direction)));
            base.lights.push_back(
                {fmt::format("{}/{}", places.name, view.names + light.name), light});
        }
    }

    static void add_light(const composition::Light& light, SceneDescription& base) {
        LightRecord record = light.record;
        const glm::dvec3 origin(base.origin[0], base.origin[1], base.origin[2]);
        record.position = Vec3(light.position - origin);
        base.lights.push_back({one_line(light.name), record});
    }

    static void add_camera(const Camera& camera, SceneDescription& base) {
        const glm::dvec3 z = glm::normalize(camera.eye - camera.target);
        const glm::dvec3 x = glm::normalize(glm::cross(camera.up, z));
        const glm::dvec3 origin(base.origin[0], base.origin[1], base.origin[2]);
        base.cameras.push_back({camera.name, pose_of(x, glm::cross(z, x), z, camera.eye - origin),
                                static_cast<float>(camera.fov * std::numbers::pi / 180), 0, 0});
    }

    Files& files_;
    const ImportLimits& limits_;
    std::string name_;
    std::vector<std::string> above_;
    Composition composition_;
    std::vector<Made> made_;
    std::uint32_t groups_open_ = 0;
    std::size_t depth_ = 1;  ///< compositions, one within the other, this one included
    std::map<std::string, std::size_t> numbers_;
    std::set<std::string> warned_;
};

}  // namespace

bool is_composition(std::string_view source) {
    return has_extension(source, ".rnscene.json");
}

Result<BuiltArena> compose(const ImportRequest& request, const ImportLimits& limits,
                           const ImportFile& import_file) {
    if (request.options != FileOptions{} || !request.masks.empty() || !request.primitive.empty() ||
        !request.variant.empty())
        return fail(ErrorCode::scene_invalid,
                    "is a composition: it says itself how to read its files, their masks and "
                    "variants");
    Files files(request, import_file);
    const NamedBytes& main = request.files.front();
    return Composer(files, limits, main.name, {main.name}).compose(main.bytes, request.origin);
}

}  // namespace raynest
