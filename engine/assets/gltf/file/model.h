// A glTF file as plain checked data, which the rest of the importer reads instead of tinygltf.
//
//   bytes --prescan--> tinygltf --load.cpp--> Model --geometry, materials, nodes-->
//   description
//
// Every index in a Model is below the size of what it refers to, or is no_id; every byte an
// accessor can reach lies inside its buffer. A damaged buffer, bufferView, accessor or picture
// describes its damage in `fault`, which matters only to the parts that use it.
#pragma once

#include "engine/assets/gltf/file/bytes.h"
#include "engine/assets/gltf/file/prescan.h"
#include "engine/assets/input/import_request.h"
#include "engine/assets/input/messages.h"
#include "engine/geometry/hit.h"
#include "engine/result.h"
#include "engine/scene/description.h"
#include "engine/scene/motion/affine.h"
#include "engine/scene/motion/motion.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace raynest::gltf {

/// Passes the error of one result on as that of another.
template <class T>
[[nodiscard]] tl::unexpected<Error> error_of(const Result<T>& result) {
    return tl::unexpected<Error>(result.error());
}

/// Returns the error with its subject prefixed: "mesh 7" + "has no vertices".
[[nodiscard]] inline tl::unexpected<Error> blame(const std::string& where, const Error& error) {
    return fail(error.code, where + ' ' + error.message);
}

enum class Component : std::uint8_t { i8, u8, i16, u16, u32, f32 };
[[nodiscard]] constexpr std::uint32_t size_of(Component component) {
    if (component == Component::i8 || component == Component::u8) return 1;
    return component == Component::i16 || component == Component::u16 ? 2 : 4;
}
/// Bounds the elements of an accessor without a bufferView. It costs no bytes in the file: all
/// elements but the sparse ones are zero.
inline constexpr std::uint64_t zero_filled_max = 1U << 20;

/// An accessor: element i has `width` components and starts at data + i * stride. Without data
/// every element is zero, except for the sparse ones.
struct Accessor {
    const std::byte* data = nullptr;
    std::uint64_t count = 0;
    std::uint32_t stride = 0;
    std::uint32_t width = 0;
    Component component = Component::f32;
    bool normalized = false;
    bool scalar_or_vector = true;  ///< otherwise a matrix, as skins have
    /// Number of elements replaced one by one; their values are packed.
    std::uint64_t sparse_count = 0;
    const std::byte* sparse_indices = nullptr;
    Component sparse_component = Component::u32;
    const std::byte* sparse_values = nullptr;
    bool misaligned = false;  ///< starts or steps as glTF forbids; costs nothing
    /// The reason why the accessor cannot be read: "accessor 3, which has a type that ...".
    std::string fault = {};
};

/// A bufferView and an accessor as a file states them, unchecked.
struct RawView {
    std::int64_t buffer = -1;
    std::uint64_t offset = 0;
    std::uint64_t length = 0;
    std::uint64_t stride = 0;
};
struct RawAccessor {
    std::int64_t view = -1;
    std::uint64_t offset = 0;
    std::uint64_t count = 0;
    int component_type = 0;
    std::uint32_t width = 0;
    bool scalar_or_vector = true;
    bool normalized = false;
    bool holds_indices = false;  ///< used as a primitive's indices
    bool sparse = false;
    std::int64_t sparse_count = 0;
    std::int64_t sparse_indices_view = -1;
    std::int64_t sparse_indices_offset = 0;
    int sparse_component_type = 0;
    std::int64_t sparse_values_view = -1;
    std::int64_t sparse_values_offset = 0;
};

/// A bufferView that has passed check_view, or the reason why it cannot be read.
struct View {
    std::span<const std::byte> bytes;
    std::uint64_t stride = 0;
    std::string fault = {};
};
/// Check ranges, for input without a fault. Errors name no subject; the caller adds it.
Result<View> check_view(const RawView& raw, std::span<const Fetched> buffers);
Result<Accessor> check_accessor(const RawAccessor& raw, std::span<const View> views);

/// Attributes that morph targets may change, and their names in a file.
enum Morphed : std::uint8_t {
    morphed_position,
    morphed_texcoord_0,
    morphed_texcoord_1,
    morphed_colour,
    morphed_normal,
    morphed_tangent
};
inline constexpr std::array<const char*, 6> morphed_names{"POSITION", "TEXCOORD_0", "TEXCOORD_1",
                                                          "COLOR_0",  "NORMAL",     "TANGENT"};
/// One accessor of differences for each of these attributes, or no_id.
using MorphTarget = std::array<std::uint32_t, morphed_names.size()>;
inline constexpr MorphTarget empty_target{no_id, no_id, no_id, no_id, no_id, no_id};

/// Four joints per vertex and their weights: two accessors.
struct JointSet {
    std::uint32_t joints = no_id;
    std::uint32_t weights = no_id;
};

struct Primitive {
    int mode = 4;
    std::uint32_t indices = no_id;  ///< accessors
    std::uint32_t position = no_id;
    std::array<std::uint32_t, 2> texcoords{no_id, no_id};
    std::uint32_t colour = no_id;
    std::uint32_t normal = no_id;
    std::uint32_t tangent = no_id;
    std::uint32_t radius = no_id;  ///< `_RADIUS` of points, which are spheres
    std::uint32_t material = no_id;
    std::vector<MorphTarget> targets;
    std::vector<JointSet> joint_sets;
};

/// An attribute that is read from a primitive: its name in a file, and where its accessor is kept.
struct AttributePlace {
    std::string name;
    std::uint32_t* accessor;
    bool is_for_shading;  ///< a mesh without it is flat: one that cannot be read is left out
};
/// THE LIST of attributes, for plain and for compressed geometry; those of joints as far as the
/// primitive has sets of them.
[[nodiscard]] std::vector<AttributePlace> attributes_of(Primitive& primitive);

struct Mesh {
    std::string name;
    std::vector<Primitive> primitives;
    std::vector<float> weights;  ///< for morph targets; those not listed are 0
    /// Index of the mesh whose primitives a posed mesh (../skins.h) uses with its own `weights`
    /// and `skin`.
    std::uint32_t pose_of = no_id;
    std::uint32_t skin = no_id;
};

struct Skin {
    std::string name;
    std::uint32_t inverse_bind = no_id;  ///< accessor; no_id: identities
    std::vector<std::uint32_t> joints;   ///< nodes
};

/// An encoded picture: a range of a buffer, bytes of its own, or the reason for their absence.
struct Image {
    std::string name;
    std::span<const std::byte> bytes;
    std::string fault = {};
};

using Matrix = Affine;
inline constexpr Matrix identity_matrix = identity_affine;

/// EXT_mesh_gpu_instancing: accessors of one element per placement, or no_id.
struct Instancing {
    std::uint32_t translation = no_id;
    std::uint32_t rotation = no_id;
    std::uint32_t scale = no_id;
    std::uint32_t count = 0;  ///< 0: the node is not instanced
};

struct Node {
    std::string name;
    Matrix local = identity_matrix;
    std::uint32_t mesh = no_id;
    std::uint32_t camera = no_id;
    std::uint32_t light = no_id;
    std::uint32_t skin = no_id;  ///< set: the mesh is in the scene's space
    std::vector<float> weights;  ///< if empty, the mesh's weights apply
    std::array<double, 10> trs{0, 0, 0, 0, 0, 0, 1, 1, 1, 1};  ///< as in MotionNode
    bool has_matrix = false;          ///< `local` is not made of parts: it cannot be animated
    bool is_animated = false;         ///< its parts change
    bool has_moving_weights = false;  ///< those of its mesh change
    bool visible = true;  ///< KHR_node_visibility: false hides meshes of the node and below it
    Instancing instancing;
    std::optional<std::uint32_t> mask;  ///< extras.raynest.mask
    std::vector<std::uint32_t> children;
};

struct Channel {
    std::uint32_t sampler = 0;
    std::uint32_t node = 0;
    MotionPath path = MotionPath::translation;
};
struct Animation {
    std::string name;
    std::vector<Channel> channels;
};

struct Camera {
    std::string name;
    float yfov = 0;  ///< angles and sizes as in CameraDescription
    float aspect = 0;
    float ymag = 0;
    std::string fault = {};  ///< what a scene with this camera says of it
};

/// A light without its place.
struct Light {
    std::string name;
    LightRecord record;
    std::string fault = {};  ///< why it is left out
};

struct Model {
    std::vector<Fetched> storage;  ///< buffers and pictures that other members point into
    std::vector<std::vector<unsigned char>> decompressed;  ///< decoded bytes of compressed geometry
    std::vector<View> views;  ///< bufferViews, decompressed where they were compressed
    std::vector<Accessor> accessors;
    std::vector<Mesh> meshes;
    std::vector<MaterialDescription> materials;  ///< textures index `textures`
    std::vector<TextureDescription> textures;    ///< `image` indexes `images`, or no_id
    std::vector<Image> images;
    std::vector<Skin> skins;
    std::vector<Node> nodes;
    std::vector<Animation> animations;
    std::vector<MotionSampler> samplers;  ///< for their channels; their numbers are in key_floats
    std::vector<float> key_floats;
    std::vector<Camera> cameras;
    std::vector<Light> lights;
    std::vector<std::uint32_t> roots;   ///< root nodes of the chosen scene
    UpAxis up = UpAxis::y;              ///< extras.raynest.up of the chosen scene
    std::vector<std::string> variants;  ///< SceneDescription::variants
    std::size_t chosen_variant = 0;
    bool quantized = false;              ///< KHR_mesh_quantization is in use
    std::uint64_t hidden_instances = 0;  ///< placements of meshes hidden by visibility
    Oddities odd;                        ///< faults that get a default
    std::vector<std::string> warnings;
    std::uint64_t upload_bytes = 0;        ///< total of all files; bounds amplification
    std::uint64_t decompressed_bytes = 0;  ///< counts towards the same bound
};

/// Loads a model: runs tinygltf in isolation, then checks every index and range. `text` is
/// request.files[0], opened; its JSON has passed prescan_json. The model owns its bytes and never
/// points into the request.
Result<Model> load_model(const ImportRequest& request, const Glb& text, const Prescan& prescan);

/// Checks an index of the file: -1 means absent and gives no_id; others must be below `size`.
Result<std::uint32_t> optional_index(std::int64_t value, std::size_t size, std::string_view what);
Result<std::uint32_t> required_index(std::int64_t value, std::size_t size, std::string_view what);

/// Checks that the nodes form a forest, and sets model.roots to those listed, or to every node
/// without a parent if the file has no scene. A node that is listed twice, or below another listed
/// node, is placed once, with a warning. Removes the meshes of hidden nodes.
Result<void> set_roots(Model& model, const std::vector<int>* listed);

/// A node of the chosen scene, and the map from its space to the scene's.
struct PlacedNode {
    std::uint32_t node;
    Matrix to_scene;
};
/// Why a camera or a light is left out for which camera_pose() finds nothing.
inline constexpr const char* no_pose =
    "has no direction or place: a scale is 0, or a position beyond 3e38";
/// Returns the nodes of the chosen scene that have a camera or a light (`what` is its member of
/// Node), in node order.
std::vector<PlacedNode> nodes_with(const Model& model, std::uint32_t Node::*what);

/// Returns a node's transform from `matrix` (16, column-major) or TRS, as the file states them.
/// Checks the count of numbers and that they are finite as floats; normalises the rotation. `where`
/// starts an error's message.
Result<Matrix> local_matrix(std::span<const double> matrix, std::span<const double> translation,
                            std::span<const double> rotation, std::span<const double> scale,
                            const std::string& where);
/// Reads elements as floats, `width` per element, normalised integers mapped to [0,1] or [-1,1]:
/// those listed in `elements` (each below accessor.count), or all if the list is empty. Pass errors
/// to blame().
Result<std::vector<float>> read_floats(const Accessor& accessor,
                                       std::span<const std::uint32_t> elements = {});
/// Reads the elements of an accessor that holds indices.
Result<std::vector<std::uint32_t>> read_indices(const Accessor& accessor);

}  // namespace raynest::gltf
