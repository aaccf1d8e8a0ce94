// Runs tinygltf in isolation and copies its output into a Model.
//
// tinygltf is a JSON reader, not a validator: it accepts indices, ranges and counts of any value.
// It gets no file system and no image decoder, and its exceptions are caught here. Its output is
// used only after the checks below.
#include "engine/assets/gltf/file/compressed.h"
#include "engine/assets/gltf/file/convert.h"
#include "engine/assets/gltf/file/values.h"
#include "engine/assets/input/messages.h"
#include "engine/assets/input/uploaded_files.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <new>
#include <optional>
#include <set>

namespace raynest::gltf {
namespace {

/// Discards a picture: its bytes are found by its bufferView. Here the pointer and the length are
/// unchecked.
bool leave_picture(tinygltf::Image*, int, std::string*, std::string*, int, int,
                   const unsigned char*, int, void*) {
    return true;
}

/// True for extensions that are read, or that do not change what a ray hits.
bool is_known(const std::string& name) {
    static const std::set<std::string, std::less<>> known{
#define RAYNEST_MATERIAL_LAYER(extension, ...) #extension,
#include "engine/shading/material_layers.def"
        "EXT_mesh_gpu_instancing", "KHR_mesh_quantization", "KHR_texture_transform",
        "KHR_lights_punctual",     "EXT_texture_webp",      "KHR_node_visibility",
        "KHR_animation_pointer",   "KHR_xmp_json_ld"};
    const Decoder* const decoder = find_decoder(name);
    return known.contains(name) || name.starts_with("KHR_materials_") ||
           (decoder != nullptr && decoder->available());
}

Result<void> check_extensions(const tinygltf::Model& file, Model& model) {
    for (const std::string& name : file.extensionsRequired) {
        if (is_known(name)) continue;
        if (const Decoder* const decoder = find_decoder(name)) return decoder->available();
        return fail(
            ErrorCode::scene_unsupported,
            fmt::format("the scene requires the extension '{}', which RayNest does not read; {}",
                        one_line(name, 80),
                        name == "KHR_texture_basisu" ? "re-export without compression"
                                                     : "re-export without it"));
    }
    std::set<std::string, std::less<>> unknown;
    for (const std::string& name : file.extensionsUsed)
        if (!is_known(name)) unknown.insert(one_line(name, 80));
    if (!unknown.empty()) {
        model.warnings.push_back(
            fmt::format("the scene uses extensions that RayNest does not read: {}",
                        one_line(fmt::format("{}", fmt::join(unknown, ", ")), 400)));
    }
    return {};
}

/// Drops complaints about members of skins and animations that glTF does not require.
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

/// Runs tinygltf on a text; an empty `problem` means that it was read.
Result<void> run_tinygltf(std::span<const std::byte> text, tinygltf::Model& file,
                          std::string& problem) {
    const auto size = static_cast<unsigned>(text.size());
    std::string warning;
    bool loaded = false;
    try {
        tinygltf::TinyGLTF loader;
        loader.SetImageLoader(leave_picture, nullptr);
        loader.SetFsCallbacks({[](const std::string&, void*) { return false; },
                               [](const std::string& name, void*) { return name; },
                               [](std::vector<unsigned char>*, std::string*, const std::string&,
                                  void*) { return false; },
                               nullptr, nullptr});
        loaded =
            starts_as_glb(text)
                ? loader.LoadBinaryFromMemory(&file, &problem, &warning,
                                              reinterpret_cast<const unsigned char*>(text.data()),
                                              size, "")
                : loader.LoadASCIIFromString(&file, &problem, &warning,
                                             reinterpret_cast<const char*>(text.data()), size, "");
    } catch (const std::bad_alloc&) {
        return fail(ErrorCode::out_of_memory,
                    "the scene needs more memory than an import may take");
    } catch (...) {  // catch-all: tinygltf's exceptions concern containers, not glTF
        problem = "its parts do not fit together";
    }
    drop_harmless_lines(problem);
    if (!loaded && problem.empty()) problem = "no reason given";
    return {};
}

/// The output of tinygltf, and the bytes that belong to it.
struct Parsed {
    tinygltf::Model file;
    std::vector<Fetched> buffers;
    std::vector<FetchedImage> images;
    std::string lost_animations;  ///< why they are left out; empty: they are not
};

/// Reads a scene whose only bytes are a BIN chunk as it is. Any other scene, and one that tinygltf
/// refuses, is rewritten first (bytes.h).
Result<Parsed> parse(const ImportRequest& request, const Glb& text, const Prescan& prescan,
                     std::uint64_t upload_bytes) {
    Parsed parsed;
    std::string problem;
    if (prescan.one_binary) {
        auto done = run_tinygltf(request.files.front().bytes, parsed.file, problem);
        if (!done) return error_of(done);
        if (problem.empty()) {
            for (tinygltf::Buffer& buffer : parsed.file.buffers)
                parsed.buffers.push_back({std::move(buffer.data)});
            for (const tinygltf::Image& image : parsed.file.images)
                parsed.images.push_back({image.name, image.bufferView, {}});
            return parsed;
        }
        parsed = {};
        problem.clear();
    }

    Upload upload(request, 4 * upload_bytes);
    auto rewritten = rewrite(text.json, text.binary, upload);
    if (!rewritten) return error_of(rewritten);
    const std::span<const char> json(rewritten->json);
    // tinygltf calls "{}" too short a text.
    if (json.size() < std::string_view(R"({"asset":{}})").size())
        return fail(ErrorCode::scene_invalid,
                    "the file has no asset.version, so it is no glTF 2.0 scene");
    if (auto done = run_tinygltf(std::as_bytes(json), parsed.file, problem); !done)
        return error_of(done);
    if (!problem.empty()) {
        // Without animations the scene is still there.
        const std::string still = without_animations(rewritten->json);
        parsed.file = {};
        parsed.lost_animations = still.size() < rewritten->json.size() ? one_line(problem) : "";
        problem.clear();
        if (auto done =
                run_tinygltf(std::as_bytes(std::span<const char>(still)), parsed.file, problem);
            !done)
            return error_of(done);
    }
    if (!problem.empty()) {
        return fail(ErrorCode::scene_invalid, "the glTF file is damaged: " + one_line(problem));
    }
    for (const std::size_t index : rewritten->untyped) parsed.file.accessors[index].type = 0;
    for (const std::size_t index : rewritten->unplaced)
        parsed.file.accessors[index].bufferView = -1;
    if (!rewritten->unplaced.empty()) parsed.file.bufferViews.pop_back();
    for (const std::size_t index : rewritten->colourless)
        parsed.file.materials[index].pbrMetallicRoughness.baseColorFactor.clear();
    for (const auto& [view, stride] : rewritten->strides)
        parsed.file.bufferViews[view].byteStride = stride;
    parsed.buffers = std::move(rewritten->buffers);
    parsed.images = std::move(rewritten->images);
    return parsed;
}

std::vector<View> convert_views(const std::vector<tinygltf::BufferView>& in, Model& model) {
    std::vector<View> views;
    for (const tinygltf::BufferView& from : in) {
        const auto buffer = static_cast<std::size_t>(from.buffer);
        const bool compressed = is_compressed(from);
        if (!compressed && buffer < model.storage.size() && !model.storage[buffer].fault.empty()) {
            views.push_back(
                {{}, 0, fmt::format("buffer {}, which {}", buffer, model.storage[buffer].fault)});
            continue;
        }
        auto checked =
            compressed
                ? decompress(from, model)
                : check_view({from.buffer, from.byteOffset, from.byteLength, from.byteStride},
                             model.storage);
        if (!checked) {
            checked = View{{},
                           0,
                           label("bufferView", views.size(), from.name) + ", which " +
                               checked.error().message};
        }
        views.push_back(std::move(*checked));
    }
    return views;
}

Image convert_image(FetchedImage& in, const std::vector<View>& views, Model& model) {
    Image image{one_line(in.name), {}, std::move(in.fetched.fault)};
    if (in.view >= 0 && static_cast<std::size_t>(in.view) < views.size()) {
        const View& view = views[static_cast<std::size_t>(in.view)];
        image.bytes = view.bytes;
        if (!view.fault.empty()) image.fault = "needs " + view.fault;
    } else if (in.view >= 0) {
        image.fault = fmt::format("is in bufferView {}, but there are {}", in.view, views.size());
    } else {
        model.storage.push_back(std::move(in.fetched));
        image.bytes = std::as_bytes(std::span(model.storage.back().bytes));
    }
    if (image.bytes.empty() && image.fault.empty()) image.fault = "is empty";
    return image;
}

Result<void> convert_accessors(Parsed& parsed, Model& model) {
    const tinygltf::Model& file = parsed.file;
    model.storage = std::move(parsed.buffers);
    model.views = convert_views(file.bufferViews, model);
    const std::vector<View>& views = model.views;
    std::uint64_t misaligned = 0;
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
        const auto view = static_cast<std::size_t>(in.bufferView);
        Accessor accessor;
        if (view < views.size() && !views[view].fault.empty()) {
            accessor.fault = views[view].fault;
        } else if (auto checked = check_accessor(raw, views)) {
            accessor = std::move(*checked);
        } else {
            accessor.fault = label("accessor", model.accessors.size(), in.name) + ", which " +
                             checked.error().message;
        }
        misaligned += accessor.misaligned ? 1U : 0U;
        model.accessors.push_back(std::move(accessor));
    }
    if (misaligned != 0) {
        model.warnings.push_back(fmt::format(
            "{} not aligned as glTF requires; read byte by byte",
            misaligned == 1 ? "1 accessor is" : fmt::format("{} accessors are", misaligned)));
    }

    // Pictures inside buffers point into them; the bytes of the others are appended to the buffers.
    for (FetchedImage& image : parsed.images)
        model.images.push_back(convert_image(image, views, model));
    return {};
}

/// Reads EXT_mesh_gpu_instancing. Attributes of the application, whose names begin with an
/// underscore, place nothing; where a node has no others, their number is that of the placements.
Result<Instancing> convert_instancing(const tinygltf::Node& in, const Model& model) {
    const auto* attributes = member(in.extensions, "EXT_mesh_gpu_instancing", "attributes");
    Instancing instancing;
    if (attributes == nullptr) return instancing;
    const auto refuse = [](const std::string& why) {
        return fail(ErrorCode::scene_invalid, "EXT_mesh_gpu_instancing" + why);
    };
    std::optional<std::uint64_t> count;
    const auto accessor_of = [&](const std::string& name) -> Result<std::uint32_t> {
        const tinygltf::Value& value = attributes->Get(name);
        if (!value.IsInt() || value.GetNumberAsInt() < 0)
            return refuse(fmt::format(": {} names no accessor", one_line(name, 80)));
        auto index = optional_index(value.GetNumberAsInt(), model.accessors.size(), "accessor");
        if (!index) return index;
        const Accessor& accessor = model.accessors[*index];
        if (!accessor.fault.empty()) return refuse(" needs " + accessor.fault);
        if (count && accessor.count != *count)
            return refuse(fmt::format(": {} has {} elements where others have {}",
                                      one_line(name, 80), accessor.count, *count));
        count = accessor.count;
        return index;
    };
    const auto read = [&](const char* name, std::uint32_t width,
                          std::uint32_t& out) -> Result<void> {
        if (!attributes->Has(name)) return {};
        const auto index = accessor_of(name);
        if (!index) return error_of(index);
        const Accessor& accessor = model.accessors[*index];
        const bool integer_rotation =
            width == 4 && accessor.normalized &&
            (accessor.component == Component::i8 || accessor.component == Component::i16);
        if (accessor.width != width || !accessor.scalar_or_vector ||
            (accessor.component != Component::f32 && !integer_rotation))
            return refuse(fmt::format(": {} has the wrong type", name));
        out = *index;
        return {};
    };
    for (const auto& done :
         {read("TRANSLATION", 3, instancing.translation), read("ROTATION", 4, instancing.rotation),
          read("SCALE", 3, instancing.scale)}) {
        if (!done) return error_of(done);
    }
    if (!count) {
        for (const std::string& name : attributes->Keys()) {
            if (!name.starts_with('_')) continue;
            if (const auto index = accessor_of(name); !index) return error_of(index);
        }
    }
    if (count.value_or(0) == 0 || *count > 0xFFFFFFFFU) return refuse(" without a placement");
    instancing.count = static_cast<std::uint32_t>(*count);
    return instancing;
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
        node.has_matrix = !in.matrix.empty();
        std::ranges::copy(in.translation, node.trs.begin());
        std::ranges::copy(in.rotation, node.trs.begin() + 3);
        std::ranges::copy(in.scale, node.trs.begin() + 7);
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
        if (const auto* visible = member(in.extensions, "KHR_node_visibility", "visible"))
            node.visible = !visible->IsBool() || visible->Get<bool>();
        model.nodes.push_back(std::move(node));
    }
    return {};
}

/// Reads cameras. Invalid parameters get the value that is used when the file states none.
Result<void> convert_cameras(tinygltf::Model& file, Model& model) {
    const auto is_positive = [](double value) {
        const auto narrow = static_cast<float>(value);
        return std::isfinite(narrow) && narrow > 0;
    };
    for (const tinygltf::Camera& in : file.cameras) {
        Camera camera;
        camera.name = one_line(in.name);
        if (in.type == "orthographic") {
            const double xmag = std::abs(in.orthographic.xmag);  // negative values mirror
            const double ymag = std::abs(in.orthographic.ymag);
            const bool fits = is_positive(xmag) && is_positive(ymag) && is_positive(xmag / ymag);
            if (!fits) camera.fault = "its xmag or ymag is 0 or not finite; 1 is used";
            camera.ymag = fits ? static_cast<float>(ymag) : 1.0F;
            camera.aspect = fits ? static_cast<float>(xmag / ymag) : 1.0F;
        } else {
            const bool fits = is_positive(in.perspective.yfov) && in.perspective.yfov < 3.14159;
            if (in.perspective.yfov == yfov_of_unknown_type)
                camera.fault =
                    "its type is unknown; a perspective camera with a yfov of 0.7 is used";
            else if (!fits)
                camera.fault = "its yfov is outside (0, pi); 0.7 is used";
            camera.yfov = fits ? static_cast<float>(in.perspective.yfov) : 0.7F;
            if (is_positive(in.perspective.aspectRatio))
                camera.aspect = static_cast<float>(in.perspective.aspectRatio);
        }
        model.cameras.push_back(std::move(camera));
    }
    return {};
}

Result<void> choose_scene(tinygltf::Model& file, Model& model) {
    const bool exists =
        file.defaultScene >= 0 && static_cast<std::size_t>(file.defaultScene) < file.scenes.size();
    if (!exists && file.defaultScene != -1) {
        model.warnings.push_back(fmt::format(
            "the file chooses scene {}, but has {}; {}", file.defaultScene, file.scenes.size(),
            file.scenes.empty() ? "all nodes are shown" : "scene 0 is shown"));
    }
    if (file.scenes.empty()) return set_roots(model, nullptr);
    const tinygltf::Scene& scene =
        file.scenes[exists ? static_cast<std::size_t>(file.defaultScene) : 0];
    if (raynest_extra(scene.extras, "up") == "z") model.up = UpAxis::z;
    return set_roots(model, &scene.nodes);
}

void take_masks(const Prescan& prescan, Model& model) {
    for (const auto& [index, mask] : prescan.masks) {
        if (index >= model.nodes.size()) return;
        model.nodes[index].mask = mask;
        if (!mask) {
            model.odd.add(label("node", index, model.nodes[index].name),
                          "extras.raynest.mask is no whole number from 0 to 4294967295 and no "
                          "string of 1 to 8 hex digits; it is ignored");
        }
    }
}

void report_types(const Prescan& prescan, const tinygltf::Model& file, Model& model) {
    for (const Prescan::Mistyped& odd : prescan.mistyped) {
        const auto name_in = [&](const auto& list) {
            return odd.element < list.size() ? list[odd.element].name : std::string();
        };
        const std::string name = odd.list == "nodes"       ? name_in(file.nodes)
                                 : odd.list == "materials" ? name_in(file.materials)
                                 : odd.list == "samplers"  ? name_in(file.samplers)
                                                           : "";
        model.odd.add(label(odd.list.substr(0, odd.list.size() - 1), odd.element, name),
                      fmt::format("{} is not {}; the default is used", odd.member, odd.wanted),
                      odd.more);
    }
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

Result<Model> load_model(const ImportRequest& request, const Glb& text, const Prescan& prescan) {
    Model model;
    for (const NamedBytes& named : request.files) model.upload_bytes += named.bytes.size();
    auto parsed = parse(request, text, prescan, model.upload_bytes);
    if (!parsed) return error_of(parsed);
    tinygltf::Model& file = parsed->file;
    if (!file.asset.version.starts_with("2.")) {
        return fail(ErrorCode::scene_unsupported,
                    fmt::format("glTF version '{}' is not supported; export the scene as glTF 2.0",
                                one_line(file.asset.version.substr(0, 20))));
    }
    if (auto done = check_extensions(file, model); !done) return error_of(done);
    model.quantized = std::find(file.extensionsUsed.begin(), file.extensionsUsed.end(),
                                "KHR_mesh_quantization") != file.extensionsUsed.end();
    if (auto done = convert_accessors(*parsed, model); !done) return error_of(done);
    if (auto done = choose_variant(file, request.variant, model); !done) return error_of(done);
    for (const auto convert :
         {convert_meshes, convert_textures, convert_materials, convert_cameras, convert_nodes,
          convert_lights, convert_skins, convert_animations, choose_scene}) {
        if (auto done = convert(file, model); !done) return error_of(done);
    }
    if (!parsed->lost_animations.empty())
        model.warnings.push_back("its animations are left out: " + parsed->lost_animations);
    take_masks(prescan, model);
    report_types(prescan, file, model);
    model.odd.append_to(model.warnings);
    return model;
}

}  // namespace raynest::gltf
