// OBJ: lines of vertices, and of faces that take positions, texture coordinates and normals by
// three indices. A scene has one index per corner, so corners that agree in all three become one
// vertex.
#include "engine/assets/formats/formats.h"
#include "engine/assets/formats/mtl.h"
#include "engine/assets/formats/obj_names.h"
#include "engine/assets/formats/shades.h"
#include "engine/assets/formats/text_reader.h"

#include <map>
#include <utility>

namespace raynest {
namespace {

struct Corner {
    std::uint32_t position = no_id, texcoord = no_id, normal = no_id;
};

/// So many vertices at a position are looked through for one that is the same. Without a bound, a
/// position with a hundred thousand texture coordinates took minutes.
constexpr int vertices_at_position_max = 64;

/// The triangles of one object with one material, three corners each.
struct Patch {
    std::uint32_t material = no_id;
    std::vector<Corner> corners;
};
struct ObjObject {
    std::string name;
    std::vector<Patch> patches;
    std::map<std::uint32_t, std::size_t> patch_of;  ///< by material
};

class ObjReader {
public:
    ObjReader(const ImportRequest& request, const ImportLimits& limits)
        : limits_(limits),
          text_(request.files.front().bytes),
          materials_(request, limits, content_) {}

    Result<FileContent> read() {
        if (text_.is_utf16()) return text_.refuse("is UTF-16, which is not read: save it as UTF-8");
        for (; !text_.at_end(); text_.next_line()) {
            if (auto done = read_line(); !done) return tl::unexpected<Error>(done.error());
        }
        for (const auto& [what, count] : left_out_)
            content_.warnings.push_back(
                fmt::format("{} left out; only faces can be hit",
                            counted(count, std::string("line of '") + what + "' is",
                                    std::string("lines of '") + what + "' are")));
        if (lacking_ != 0)
            content_.warnings.push_back(fmt::format(
                "{} a normal or texture coordinate that is not there; these are left out",
                counted(lacking_, "corner names", "corners name")));
        if (!shades_.empty()) shades_.resize(4 * positions_.size(), no_shade);
        colours_ = bytes_of_shades(shades_);
        first_use_.assign(positions_.size(), no_id);
        for (ObjObject& object : objects_) {
            FileObject& to = content_.objects.emplace_back();
            to.name = std::move(object.name);
            for (Patch& patch : object.patches) to.geometries.push_back(geometry_of(patch));
        }
        return std::move(content_);
    }

private:
    Result<void> read_line() {
        const std::string_view key = text_.word();
        if (key == "v") return read_position();
        if (key == "f" || key == "fo") return read_face();
        if (key == "vn" || key == "vt") return read_attribute(key == "vn");
        if (key.empty() || key[0] == '#') return {};
        if (key == "o" || key == "g") return enter(text_.rest(), key == "o");
        if (key == "usemtl") {
            const std::string_view name = text_.rest();
            material_ = name.empty() ? no_id : materials_.find(name);
            patch_ = nullptr;
        } else if (key == "mtllib") {
            for (const std::string_view file : files_of_mtllib(text_.rest()))
                if (auto done = materials_.read(file); !done) return done;
        } else if (key == "p" || key == "l" || key == "curv" || key == "curv2" || key == "surf") {
            ++left_out_[std::string(key)];
        }
        return {};
    }

    Result<void> read_position() {
        glm::dvec3 p;
        if (!text_.number(p.x) || !text_.number(p.y) || !text_.number(p.z))
            return text_.refuse(text_.next_word() + " is no coordinate; 'v' has three");
        positions_.push_back(p);
        // "v x y z r g b" is common, "v x y z w" is not.
        glm::dvec3 colour;
        if (!text_.number(colour.x) || !text_.number(colour.y) || !text_.number(colour.z))
            return {};
        shades_.resize(4 * (positions_.size() - 1), no_shade);
        for (const double shade : {colour.x, colour.y, colour.z})
            shades_.push_back(static_cast<float>(shade));
        shades_.push_back(no_shade);
        return {};
    }

    Result<void> read_attribute(bool is_normal) {
        glm::dvec3 p(0);
        if (!text_.number(p.x) || (is_normal && (!text_.number(p.y) || !text_.number(p.z))))
            return text_.refuse(text_.next_word() + (is_normal ? " is no number; 'vn' has three"
                                                               : " is no number; 'vt' has two"));
        if (!is_normal) static_cast<void>(text_.number(p.y));
        if (is_normal)
            normals_.emplace_back(p);
        else  // OBJ counts pictures from below, glTF from above
            texcoords_.emplace_back(static_cast<float>(p.x), static_cast<float>(1 - p.y));
        return {};
    }

    /// Reads an index and makes it count from 0. Negative ones count back from the end. Rays need
    /// vertices alone: of other things no_id stands for what is not there.
    Result<std::uint32_t> read_index(bool is_vertex, std::size_t count) {
        std::int64_t index = 0;
        if (!text_.whole(index))
            return text_.refuse(text_.next_word() +
                                " is no corner of a face such as 1, 1/2 or 1/2/3");
        const auto end = static_cast<std::int64_t>(count);
        const bool is_there = index != 0 && index <= end && index >= -end;
        if (!is_there && is_vertex)
            return text_.refuse(fmt::format(
                "the face uses vertex {} of {} before it; they count from 1", index, count));
        if (!is_there) {
            ++lacking_;
            return no_id;
        }
        return static_cast<std::uint32_t>(index > 0 ? index - 1 : end + index);
    }

    Result<Corner> read_corner() {
        Corner corner;
        const auto take = [&](std::uint32_t& place, std::size_t count) -> Result<void> {
            const auto index = read_index(&place == &corner.position, count);
            if (!index) return tl::unexpected<Error>(index.error());
            place = *index;
            return {};
        };
        Result<void> done = take(corner.position, positions_.size());
        if (done && text_.take('/') && !text_.is_word_end()) {
            if (!text_.take('/')) {
                done = take(corner.texcoord, texcoords_.size());
                if (done && text_.take('/') && !text_.is_word_end())
                    done = take(corner.normal, normals_.size());
            } else if (!text_.is_word_end()) {
                done = take(corner.normal, normals_.size());
            }
        }
        if (!done) return tl::unexpected<Error>(done.error());
        if (!text_.is_word_end())
            return text_.refuse(text_.next_word() +
                                " is no corner of a face such as 1, 1/2 or 1/2/3");
        return corner;
    }

    Result<void> read_face() {
        polygon_.clear();
        while (!text_.is_line_end()) {
            const auto corner = read_corner();
            if (!corner) return tl::unexpected<Error>(corner.error());
            polygon_.push_back(*corner);
        }
        if (polygon_.size() < 3) {
            ++left_out_["f with fewer than three corners"];
            return {};
        }
        std::vector<Corner>& to = patch().corners;
        if (polygon_.size() == 3) {
            to.insert(to.end(), polygon_.begin(), polygon_.end());
            return {};
        }
        corners_.clear();
        triangles_.clear();
        for (const Corner& corner : polygon_) corners_.push_back(corner.position);
        triangulate(positions_, corners_, triangles_);
        for (const std::uint32_t place : triangles_) to.push_back(polygon_[place]);
        return {};
    }

    /// "o" names what follows; "g" does where there is no "o".
    Result<void> enter(std::string_view name, bool is_object) {
        if (!is_object && has_objects_) return {};
        has_objects_ = has_objects_ || is_object;
        name_ = front_of(name, 1024);
        object_ = no_id;
        patch_ = nullptr;
        return {};
    }

    /// The patch of the current object and material.
    Patch& patch() {
        if (patch_ != nullptr) return *patch_;
        if (object_ == no_id) {
            // A name that comes again goes on with its object.
            const auto [known, is_new] =
                object_of_.emplace(name_, static_cast<std::uint32_t>(objects_.size()));
            object_ = known->second;
            if (is_new) objects_.push_back({name_, {}, {}});
        }
        ObjObject& object = objects_[object_];
        const auto [known, is_new] = object.patch_of.emplace(material_, object.patches.size());
        if (is_new) object.patches.push_back({material_, {}});
        return *(patch_ = &object.patches[known->second]);
    }

    FileGeometry geometry_of(Patch& patch) {
        FileGeometry geometry;
        GeometryDescription& rest = geometry.rest;
        rest.material = patch.material;
        bool has_normals = true;
        bool has_texcoords = true;
        for (const Corner& corner : patch.corners) {
            has_normals = has_normals && corner.normal != no_id;
            has_texcoords = has_texcoords && corner.texcoord != no_id;
        }
        struct Vertex {
            Corner corner;
            std::uint32_t next;  ///< another vertex at the same position
        };
        std::vector<Vertex> vertices;
        rest.indices.reserve(patch.corners.size());
        for (Corner corner : patch.corners) {
            if (!has_normals) corner.normal = no_id;
            if (!has_texcoords) corner.texcoord = no_id;
            std::uint32_t& first = first_use_[corner.position];
            std::uint32_t vertex = first;
            int looked_at = 0;
            while (vertex != no_id && (vertices[vertex].corner.texcoord != corner.texcoord ||
                                       vertices[vertex].corner.normal != corner.normal))
                vertex = ++looked_at < vertices_at_position_max ? vertices[vertex].next : no_id;
            if (vertex == no_id) {
                vertex = static_cast<std::uint32_t>(vertices.size());
                vertices.push_back({corner, std::exchange(first, vertex)});
                geometry.positions.push_back(positions_[corner.position]);
                if (has_normals) rest.normals.push_back(normals_[corner.normal]);
                if (has_texcoords) rest.texcoords[0].push_back(texcoords_[corner.texcoord]);
                if (!colours_.empty()) {
                    const auto from =
                        colours_.begin() + 4 * static_cast<std::ptrdiff_t>(corner.position);
                    rest.colours.insert(rest.colours.end(), from, from + 4);
                }
            }
            rest.indices.push_back(vertex);
        }
        for (const Vertex& vertex : vertices) first_use_[vertex.corner.position] = no_id;
        patch.corners = {};
        return geometry;
    }

    const ImportLimits& limits_;
    TextReader text_;
    FileContent content_;
    MtlReader materials_;
    std::vector<glm::dvec3> positions_;
    std::vector<Vec3> normals_;
    std::vector<Vec2> texcoords_;
    std::vector<float> shades_;          ///< empty, or RGBA of the first positions
    std::vector<std::uint8_t> colours_;  ///< empty, or RGBA of all positions
    std::vector<ObjObject> objects_;
    std::map<std::string, std::uint32_t, std::less<>> object_of_;
    std::map<std::string, std::uint64_t> left_out_;
    std::uint64_t lacking_ = 0;  ///< normals and texture coordinates that are not there
    std::string name_;
    std::uint32_t object_ = no_id;
    std::uint32_t material_ = no_id;
    Patch* patch_ = nullptr;  ///< null: to be looked up
    bool has_objects_ = false;
    std::vector<Corner> polygon_;
    std::vector<std::uint32_t> corners_, triangles_;
    std::vector<std::uint32_t> first_use_;  ///< by position: the vertex made last
};

}  // namespace

Result<FileContent> read_obj(const ImportRequest& request, const ImportLimits& limits) {
    return ObjReader(request, limits).read();
}

}  // namespace raynest
