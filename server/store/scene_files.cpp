#include "server/store/scene_files.h"

#include "engine/assets/composition/compose.h"
#include "engine/assets/formats/obj_names.h"
#include "engine/assets/gltf/file/prescan.h"
#include "engine/assets/gltf/file/uri.h"
#include "engine/assets/input/uploaded_files.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <set>

namespace raynest::server {
namespace {

using Json = nlohmann::json;

/// Collects the files that a JSON text names: `uri` of the objects in the top-level arrays "buffers"
/// and "images" of a glTF, `file` and `matrices` anywhere in a composition. Builds no document in
/// memory, so that a hostile file costs little.
class NameCollector final : public nlohmann::json_sax<Json> {
public:
    /// `by` is the name of the file that holds the text.
    explicit NameCollector(std::string_view by) : by_(by), is_composition_(is_composition(by)) {}
    std::vector<std::string> names;

    bool null() override { return true; }
    bool boolean(bool) override { return true; }
    bool number_integer(number_integer_t) override { return true; }
    bool number_unsigned(number_unsigned_t) override { return true; }
    bool number_float(number_float_t, const string_t&) override { return true; }
    bool binary(binary_t&) override { return true; }
    bool string(string_t& value) override {
        const bool is_name = is_composition_ ? key_ == "file" || key_ == "matrices"
                                             : depth_ == 3 && in_files_ && key_ == "uri";
        if (!is_name) return true;
        auto name = is_composition_ ? file_of_name(by_, value) : gltf::file_of_uri(value);
        if (name && !is_composition_) name->insert(0, by_.substr(0, by_.rfind('/') + 1));
        if (name && std::find(names.begin(), names.end(), *name) == names.end())
            names.push_back(std::move(*name));
        return names.size() <= names_max;
    }
    bool start_object(std::size_t) override { return ++depth_ <= depth_max; }
    bool start_array(std::size_t) override { return ++depth_ <= depth_max; }
    bool end_object() override { return --depth_ >= 0; }
    bool end_array() override { return --depth_ >= 0; }
    bool key(string_t& value) override {
        if (depth_ == 1) in_files_ = value == "buffers" || value == "images";
        key_ = value;
        return true;
    }
    bool parse_error(std::size_t, const std::string&, const nlohmann::detail::exception&) override {
        return false;
    }

private:
    static constexpr int depth_max = 64;
    static constexpr std::size_t names_max = 4096;
    std::string_view by_;
    bool is_composition_;
    int depth_ = 0;
    bool in_files_ = false;
    std::string key_;
};

}  // namespace

std::vector<std::string> named_files(std::string_view file, std::span<const std::byte> bytes,
                                     std::size_t names_max) {
    const bool is_json =
        has_extension(file, ".gltf") || has_extension(file, ".glb") || is_composition(file);
    if (!is_json) return files_named_by(file, bytes, names_max);
    std::span<const std::byte> json = bytes;
    if (gltf::starts_as_glb(bytes)) {
        const auto chunk = gltf::open_glb(bytes);
        if (!chunk) return {};
        json = chunk->json;
    }
    NameCollector collector(file);
    const char* text = reinterpret_cast<const char*>(json.data());
    Json::sax_parse(text, text + json.size(), &collector);
    return std::move(collector.names);
}

Result<std::vector<SourceFile>> read_scene(const std::filesystem::path& root, std::string_view path,
                                           std::size_t files_max, std::uint64_t bytes_max,
                                           const LoadMemory& memory) {
    const std::filesystem::path whole(path);
    const std::filesystem::path folder = whole.parent_path();
    auto main = read_under_root(root, folder, whole.filename().string(), bytes_max, memory);
    if (!main) return tl::unexpected(main.error());
    if (!*main)
        return fail(ErrorCode::scene_invalid,
                    "cannot open root:" + std::string(path) + ": there is no such file");

    std::uint64_t left = bytes_max - (*main)->bytes.size();
    std::vector<SourceFile> files;
    files.push_back(std::move(**main));
    // A file that is named may name others in turn, which go to the end of the list. Missing files
    // count, too: looking for each costs an opening.
    std::set<std::string> known{files.front().name};
    for (std::size_t i = 0; i < files.size(); ++i) {
        for (const std::string& name : named_files(files[i].name, files[i].bytes, files_max)) {
            if (!known.insert(name).second) continue;
            if (known.size() > files_max)
                return fail(ErrorCode::limit_exceeded, "root:" + std::string(path) +
                                                           " names over " +
                                                           std::to_string(files_max) + " files");
            auto file = read_under_root(root, folder, name, left, memory);
            if (!file) return tl::unexpected(file.error());
            // Skip a missing file; the import reports it if it needs it.
            if (!*file) continue;
            left -= (*file)->bytes.size();
            files.push_back(std::move(**file));
        }
    }
    return files;
}

}  // namespace raynest::server
