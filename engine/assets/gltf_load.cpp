// Runs tinygltf behind fences and copies what it read into a Model.
//
// tinygltf is a JSON reader, not a validator: it accepts indices, ranges and counts of any value.
// It gets no file system (only the uploaded names), no image decoder, and no chance to throw
// further. Nothing it produced is used before the checks below.
#include "engine/assets/gltf_convert.h"
#include "engine/assets/gltf_names.h"
#include "engine/assets/gltf_prescan.h"
#include "engine/assets/gltf_skins.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <new>
#include <set>

namespace raynest::gltf {
namespace {

bool upload_has(const std::string& name, void* user) {
    return static_cast<Upload*>(user)->has(name);
}

bool upload_read(std::vector<unsigned char>* out, std::string* error, const std::string& name,
                 void* user) {
    const auto bytes = static_cast<Upload*>(user)->read(name);
    if (!bytes) *error = "refused";
    if (!bytes) return false;
    const auto* first = reinterpret_cast<const unsigned char*>(bytes->data());
    out->assign(first, first + bytes->size());
    return true;
}

/// Keeps encoded bytes for later. For a picture inside a buffer it must not even look: the pointer
/// and the length are unchecked there.
bool keep_encoded(tinygltf::Image* image, int, std::string*, std::string*, int, int,
                  const unsigned char* bytes, int size, void*) {
    if (image->bufferView < 0 && size > 0) image->image.assign(bytes, bytes + size);
    return true;
}

Result<void> check_extensions(const tinygltf::Model& file) {
    static const std::set<std::string, std::less<>> known{
        "EXT_mesh_gpu_instancing", "KHR_mesh_quantization", "KHR_texture_transform",
        "KHR_lights_punctual", "EXT_texture_webp"};
    for (const std::string& name : file.extensionsRequired) {
        if (known.contains(name) || name.starts_with("KHR_materials_")) continue;
        const bool compressed = name == "KHR_draco_mesh_compression" ||
                                name == "EXT_meshopt_compression" || name == "KHR_texture_basisu";
        return fail(
            ErrorCode::scene_unsupported,
            fmt::format("the scene requires the extension '{}', which RayNest does not read; {}",
                        one_line(name.substr(0, 80)),
                        compressed ? "re-export without compression" : "re-export without it"));
    }
    return {};
}

/// tinygltf complains about members of skins and animations that glTF does not require.
void drop_harmless_lines(std::string& problem) {
    std::string kept;
    for (std::size_t at = 0; at < problem.size();) {
        const std::size_t end = std::min(problem.find('\n', at), problem.size());
        const std::string line = problem.substr(at, end - at);
        const bool harmless = line.find("inverseBindMatrices") != std::string::npos ||
                              line.find("nimation") != std::string::npos ||
                              line.find("'node' property is missing") != std::string::npos;
        if (!harmless) kept += line + '\n';
        at = end + 1;
    }
    problem = kept.find_first_not_of(" \n") == std::string::npos ? std::string() : kept;
}

Result<void> run_tinygltf(const ImportRequest& request, std::uint64_t upload_bytes,
                          tinygltf::Model& file) {
    const std::span<const std::byte> main = request.files.front().bytes;
    const auto* bytes = reinterpret_cast<const unsigned char*>(main.data());
    Upload upload(request, 4 * upload_bytes);

    std::string problem;
    std::string warning;
    bool loaded = false;
    try {
        tinygltf::TinyGLTF loader;
        loader.SetImageLoader(keep_encoded, nullptr);
        loader.SetFsCallbacks({upload_has, [](const std::string& name, void*) { return name; },
                               upload_read, nullptr, &upload});
        const auto size = static_cast<unsigned>(main.size());
        loaded = starts_as_glb(main)
                     ? loader.LoadBinaryFromMemory(&file, &problem, &warning, bytes, size, "")
                     : loader.LoadASCIIFromString(&file, &problem, &warning,
                                                  reinterpret_cast<const char*>(bytes), size, "");
    } catch (const std::bad_alloc&) {
        return fail(ErrorCode::out_of_memory,
                    "the scene needs more memory than an import may take; start raynestd with a "
                    "larger --memory");
    } catch (...) {  // what tinygltf lets through speaks of containers, not of glTF
        return fail(ErrorCode::scene_invalid, "the glTF file is damaged; export it again");
    }

    drop_harmless_lines(problem);
    if (loaded && problem.empty()) return {};
    if (problem.find("File not found") != std::string::npos) return upload.missing_file();
    return fail(ErrorCode::scene_invalid,
                fmt::format("the glTF file is damaged: {}",
                            problem.empty() ? "no reason given" : one_line(problem)));
}

Result<void> convert_accessors(tinygltf::Model& file, Model& model) {
    for (tinygltf::Buffer& buffer : file.buffers) model.storage.push_back(std::move(buffer.data));
    std::vector<View> views;
    for (const tinygltf::BufferView& view : file.bufferViews) {
        auto checked = check_view({view.buffer, view.byteOffset, view.byteLength, view.byteStride},
                                  model.storage);
        if (!checked) return blame(label("bufferView", views.size(), view.name), checked.error());
        views.push_back(*checked);
    }

    std::vector<bool> holds_indices(file.accessors.size(), false);
    for (const tinygltf::Mesh& mesh : file.meshes) {
        for (const tinygltf::Primitive& primitive : mesh.primitives) {
            const auto index = static_cast<std::size_t>(primitive.indices);
            if (index < holds_indices.size()) holds_indices[index] = true;
        }
    }
    for (const tinygltf::Accessor& in : file.accessors) {
        RawAccessor raw{
            in.bufferView,
            in.byteOffset,
            in.count,
            in.componentType,
            static_cast<std::uint32_t>(
                std::max(0, tinygltf::GetNumComponentsInType(static_cast<std::uint32_t>(in.type)))),
            in.type <= TINYGLTF_TYPE_VEC4 || in.type == TINYGLTF_TYPE_SCALAR,
            in.normalized,
            holds_indices[model.accessors.size()]};
        if (in.sparse.isSparse) {
            raw.sparse = true;
            raw.sparse_count = in.sparse.count;
            raw.sparse_indices_view = in.sparse.indices.bufferView;
            raw.sparse_indices_offset = in.sparse.indices.byteOffset;
            raw.sparse_component_type = in.sparse.indices.componentType;
            raw.sparse_values_view = in.sparse.values.bufferView;
            raw.sparse_values_offset = in.sparse.values.byteOffset;
        }
        auto checked = check_accessor(raw, views);
        if (!checked)
            return blame(label("accessor", model.accessors.size(), in.name), checked.error());
        model.accessors.push_back(*checked);
    }

    // Pictures inside buffers point there; the bytes of the others move behind the buffers.
    for (tinygltf::Image& in : file.images) {
        const auto view = optional_index(in.bufferView, views.size(), "bufferView");
        if (!view) return error_of(view);
        Image image{one_line(in.name.empty() ? in.uri : in.name), {}};
        if (*view != no_id) image.bytes = views[*view].bytes;
        if (*view == no_id && !in.image.empty()) {
            model.storage.push_back(std::move(in.image));
            image.bytes = std::as_bytes(std::span(model.storage.back()));
        }
        model.images.push_back(std::move(image));
    }
    return {};
}

Result<Wrap> convert_wrap(int value) {
    switch (value) {
        case TINYGLTF_TEXTURE_WRAP_REPEAT:
            return Wrap::repeat;
        case TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE:
            return Wrap::clamp;
        case TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT:
            return Wrap::mirror;
        default:
            return fail(ErrorCode::scene_invalid,
                        fmt::format("sampler wrap mode {} is unknown", value));
    }
}

Result<void> convert_textures(tinygltf::Model& file, Model& model) {
    for (const tinygltf::Texture& in : file.textures) {
        // A WebP picture stands in an extension, with a fallback in the usual place.
        int source_index = in.source;
        if (const auto* webp = member(in.extensions, "EXT_texture_webp", "source")) {
            if (webp->IsInt()) source_index = webp->GetNumberAsInt();
        }
        const auto source = optional_index(source_index, model.images.size(), "image");
        const auto sampler = optional_index(in.sampler, file.samplers.size(), "sampler");
        if (!source) return error_of(source);
        if (!sampler) return error_of(sampler);
        TextureDescription texture{*source};
        if (*sampler != no_id) {
            const tinygltf::Sampler& from = file.samplers[*sampler];
            const auto wrap_s = convert_wrap(from.wrapS);
            const auto wrap_t = convert_wrap(from.wrapT);
            if (!wrap_s) return error_of(wrap_s);
            if (!wrap_t) return error_of(wrap_t);
            texture.wrap_s = *wrap_s;
            texture.wrap_t = *wrap_t;
            texture.nearest = from.magFilter == TINYGLTF_TEXTURE_FILTER_NEAREST;
        }
        model.textures.push_back(texture);
    }
    return {};
}

/// KHR_texture_transform as two rows of an affine map. The extension's text turns the UVs counter-
/// clockwise as seen on the image, whose v runs down: u' = c u + s v. (Its GLSL snippet has the
/// other sign; viewers follow the text and the Khronos test model.)
Result<void> convert_uv_transform(const tinygltf::TextureInfo& info,
                                  MaterialDescription& material) {
    constexpr const char* extension = "KHR_texture_transform";
    double offset[2] = {0, 0};
    double scale[2] = {1, 1};
    double rotation = 0;
    const auto read_pair = [&](const char* name, double(&pair)[2]) {
        const tinygltf::Value* value = member(info.extensions, extension, name);
        if (value == nullptr) return true;
        if (!value->IsArray() || value->ArrayLen() != 2) return false;
        for (int i = 0; i < 2; ++i) {
            if (!value->Get(i).IsNumber()) return false;
            pair[i] = value->Get(i).GetNumberAsDouble();
        }
        return true;
    };
    bool valid = read_pair("offset", offset) && read_pair("scale", scale);
    if (const auto* value = member(info.extensions, extension, "rotation")) {
        valid = valid && value->IsNumber();
        if (valid) rotation = value->GetNumberAsDouble();
    }
    if (const auto* value = member(info.extensions, extension, "texCoord")) {
        valid = valid && value->IsInt() && value->GetNumberAsInt() >= 0;
        if (valid) material.texcoord = static_cast<std::uint32_t>(value->GetNumberAsInt());
    }
    const double c = std::cos(rotation);
    const double s = std::sin(rotation);
    const double rows[6] = {c * scale[0],  s * scale[1], offset[0],
                            -s * scale[0], c * scale[1], offset[1]};
    for (std::size_t i = 0; i < 6 && valid; ++i) {
        material.uv_transform[i] = static_cast<float>(rows[i]);
        valid = std::isfinite(material.uv_transform[i]);
    }
    if (valid) return {};
    return fail(ErrorCode::scene_invalid,
                "a KHR_texture_transform does not hold the numbers it must");
}

Result<void> convert_materials(tinygltf::Model& file, Model& model) {
    for (const tinygltf::Material& in : file.materials) {
        const tinygltf::PbrMetallicRoughness& pbr = in.pbrMetallicRoughness;
        MaterialDescription material;
        material.name = one_line(in.name);
        material.double_sided = in.doubleSided;
        const std::string where = label("material", model.materials.size(), in.name);
        if (in.alphaMode == "MASK")
            material.alpha_mode = AlphaMode::mask;
        else if (in.alphaMode == "BLEND")
            material.alpha_mode = AlphaMode::blend;
        else if (in.alphaMode != "OPAQUE") {
            return fail(ErrorCode::scene_invalid, where + " has an unknown alphaMode");
        }
        const auto cutoff = finite(in.alphaCutoff, where + ": alphaCutoff");
        if (!cutoff) return error_of(cutoff);
        if (*cutoff < 0)
            return fail(ErrorCode::scene_invalid, where + " has a negative alphaCutoff");
        material.cutoff = *cutoff;
        if (pbr.baseColorFactor.size() != 4) {
            return fail(ErrorCode::scene_invalid, where + ": baseColorFactor must be four numbers");
        }
        for (int i = 0; i < 4; ++i) {
            const auto value = finite(pbr.baseColorFactor[static_cast<std::size_t>(i)],
                                      where + ": baseColorFactor");
            if (!value) return error_of(value);
            material.base_colour[i] = *value;
        }
        const auto texture =
            optional_index(pbr.baseColorTexture.index, model.textures.size(), "texture");
        if (!texture) return error_of(texture);
        material.texture = *texture;
        if (pbr.baseColorTexture.texCoord < 0) {
            return fail(ErrorCode::scene_invalid, where + " has a negative texCoord");
        }
        material.texcoord = static_cast<std::uint32_t>(pbr.baseColorTexture.texCoord);
        if (auto done = convert_uv_transform(pbr.baseColorTexture, material); !done) return done;
        model.materials.push_back(std::move(material));
    }
    return {};
}

Result<Instancing> convert_instancing(const tinygltf::Node& in, const Model& model) {
    const auto* attributes = member(in.extensions, "EXT_mesh_gpu_instancing", "attributes");
    Instancing instancing;
    if (attributes == nullptr) return instancing;
    std::uint64_t count = 0;
    bool first = true;
    const auto read = [&](const char* name, std::uint32_t width,
                          std::uint32_t& out) -> Result<void> {
        if (!attributes->Has(name)) return {};
        const tinygltf::Value& value = attributes->Get(name);
        const auto index =
            value.IsInt() && value.GetNumberAsInt() >= 0
                ? optional_index(value.GetNumberAsInt(), model.accessors.size(), "accessor")
                : fail(ErrorCode::scene_invalid,
                       fmt::format("EXT_mesh_gpu_instancing: {} names no accessor", name));
        if (!index) return error_of(index);
        const Accessor& accessor = model.accessors[*index];
        const bool integer_rotation =
            width == 4 && accessor.normalized &&
            (accessor.component == Component::i8 || accessor.component == Component::i16);
        if (accessor.width != width || !accessor.scalar_or_vector || accessor.data == nullptr ||
            (accessor.component != Component::f32 && !integer_rotation)) {
            return fail(ErrorCode::scene_invalid,
                        fmt::format("EXT_mesh_gpu_instancing: {} has the wrong type", name));
        }
        if (!first && accessor.count != count) {
            return fail(
                ErrorCode::scene_invalid,
                fmt::format("EXT_mesh_gpu_instancing: {} has {} elements where others have {}",
                            name, accessor.count, count));
        }
        first = false;
        count = accessor.count;
        out = *index;
        return {};
    };
    for (const auto& done :
         {read("TRANSLATION", 3, instancing.translation), read("ROTATION", 4, instancing.rotation),
          read("SCALE", 3, instancing.scale)}) {
        if (!done) return error_of(done);
    }
    if (count == 0 || count > 0xFFFFFFFFU) {
        return fail(ErrorCode::scene_invalid, "EXT_mesh_gpu_instancing without a placement");
    }
    instancing.count = static_cast<std::uint32_t>(count);
    return instancing;
}

/// extras.raynest.mask: a whole number, or a text of hex digits. tinygltf reads numbers as int; the
/// bits of 4294967295 arrive as -1.
void convert_mask(const tinygltf::Node& in, Node& node, Model& model) {
    if (!in.extras.IsObject() || !in.extras.Has("raynest")) return;
    const tinygltf::Value& ours = in.extras.Get("raynest");
    if (!ours.IsObject() || !ours.Has("mask")) return;
    const tinygltf::Value& value = ours.Get("mask");
    if (value.IsInt()) node.mask = static_cast<std::uint32_t>(value.GetNumberAsInt());
    if (value.IsString()) node.mask = MaskRules::parse_mask(value.Get<std::string>());
    if (!node.mask) ++model.bad_masks;
}

Result<void> convert_nodes(tinygltf::Model& file, Model& model) {
    for (const tinygltf::Node& in : file.nodes) {
        const std::string where = label("node", model.nodes.size(), in.name);
        Node node;
        node.name = one_line(in.name);
        const auto mesh = optional_index(in.mesh, model.meshes.size(), "mesh");
        const auto camera = optional_index(in.camera, model.cameras.size(), "camera");
        const auto instancing = convert_instancing(in, model);
        const auto local = local_matrix(in.matrix, in.translation, in.rotation, in.scale, where);
        if (!mesh) return error_of(mesh);
        if (!camera) return error_of(camera);
        if (!instancing) return error_of(instancing);
        if (!local) return error_of(local);
        node.mesh = *mesh;
        node.camera = *camera;
        node.instancing = *instancing;
        node.local = *local;
        for (const int child : in.children) {
            const auto index = required_index(child, file.nodes.size(), "child node");
            if (!index) return error_of(index);
            node.children.push_back(*index);
        }
        auto weights = finite_list(in.weights, where + ": a morph weight");
        const auto skin = optional_index(in.skin, file.skins.size(), "skin");
        if (!weights) return error_of(weights);
        if (!skin) return error_of(skin);
        node.weights = std::move(*weights);
        node.skin = *skin;
        convert_mask(in, node, model);
        model.nodes.push_back(std::move(node));
    }
    return {};
}

Result<void> convert_cameras(tinygltf::Model& file, Model& model) {
    for (const tinygltf::Camera& in : file.cameras) {
        Camera camera{one_line(in.name), in.type == "perspective"};
        if (camera.perspective) {
            const auto yfov = finite(in.perspective.yfov, "a camera's yfov");
            const auto aspect = finite(in.perspective.aspectRatio, "a camera's aspectRatio");
            if (!yfov) return error_of(yfov);
            if (!aspect) return error_of(aspect);
            if (!(*yfov > 0 && *yfov < 3.14159F) || *aspect < 0) {
                return fail(
                    ErrorCode::scene_invalid,
                    fmt::format("camera {} has a yfov outside (0, pi) or a negative aspectRatio",
                                model.cameras.size()));
            }
            camera.yfov = *yfov;
            camera.aspect = *aspect;
        }
        model.cameras.push_back(std::move(camera));
    }
    return {};
}

Result<void> choose_scene(tinygltf::Model& file, Model& model) {
    const auto scene = optional_index(file.defaultScene, file.scenes.size(), "scene");
    if (!scene) return error_of(scene);
    if (file.scenes.empty()) return set_roots(model, nullptr);
    return set_roots(model, &file.scenes[*scene == no_id ? 0 : *scene].nodes);
}

}  // namespace

const tinygltf::Value* member(const tinygltf::ExtensionMap& extensions, const char* extension,
                              const char* name) {
    const auto found = extensions.find(extension);
    if (found == extensions.end() || !found->second.Has(name)) return nullptr;
    return &found->second.Get(name);
}

Result<float> finite(double value, std::string_view what) {
    const auto narrow = static_cast<float>(value);
    if (std::isfinite(narrow)) return narrow;
    return fail(ErrorCode::scene_invalid, fmt::format("{} does not fit a float", what));
}

Result<std::vector<float>> finite_list(std::span<const double> values, std::string_view what) {
    std::vector<float> list;
    for (const double value : values) {
        const auto narrow = finite(value, what);
        if (!narrow) return error_of(narrow);
        list.push_back(*narrow);
    }
    return list;
}

Result<Model> load_model(const ImportRequest& request) {
    Model model;
    for (const NamedBytes& named : request.files) model.upload_bytes += named.bytes.size();
    tinygltf::Model file;
    if (auto done = run_tinygltf(request, model.upload_bytes, file); !done) return error_of(done);
    if (!file.asset.version.starts_with("2.")) {
        return fail(ErrorCode::scene_unsupported,
                    fmt::format("glTF version '{}' is not supported; export the scene as glTF 2.0",
                                one_line(file.asset.version.substr(0, 20))));
    }
    if (auto done = check_extensions(file); !done) return error_of(done);
    model.quantized = std::find(file.extensionsUsed.begin(), file.extensionsUsed.end(),
                                "KHR_mesh_quantization") != file.extensionsUsed.end();
    for (const auto convert :
         {convert_accessors, convert_meshes, convert_textures, convert_materials, convert_cameras,
          convert_nodes, convert_skins, choose_scene}) {
        if (auto done = convert(file, model); !done) return error_of(done);
    }
    separate_poses(model);
    return model;
}

}  // namespace raynest::gltf
