#include "server/store/scene_files.h"

#include "engine/assets/formats/obj_names.h"
#include "engine/assets/gltf/file/prescan.h"
#include "engine/assets/gltf/file/uri.h"
#include "engine/assets/input/uploaded_files.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <deque>

namespace raynest::server {
namespace {

using Json = nlohmann::json;

/// Collects `uri` of the objects in the top-level arrays "buffers" and "images". Builds no document
/// in memory, so that a hostile file costs little.
class UriCollector final : public nlohmann::json_sax<Json> {
public:
    std::vector<std::string> names;

    bool null() override { return true; }
    bool boolean(bool) override { return true; }
    bool number_integer(number_integer_t) override { return true; }
    bool number_unsigned(number_unsigned_t) override { return true; }
    bool number_float(number_float_t, const string_t&) override { return true; }
    bool binary(binary_t&) override { return true; }
    bool string(string_t& value) override {
        if (depth_ != 3 || !in_files_ || key_ != "uri") return true;
        auto name = gltf::file_of_uri(value);
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
    int depth_ = 0;
    bool in_files_ = false;
    std::string key_;
};

}  // namespace

std::vector<std::string> named_files(std::span<const std::byte> main_file) {
    std::span<const std::byte> json = main_file;
    if (gltf::starts_as_glb(main_file)) {
        const auto chunk = gltf::open_glb(main_file);
        if (!chunk) return {};
        json = chunk->json;
    }
    UriCollector collector;
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

    const std::vector<std::string> names =
        has_extension(path, ".obj") ? files_named_by((*main)->name, (*main)->bytes, files_max)
                                    : named_files((*main)->bytes);
    if (names.size() >= files_max)
        return fail(ErrorCode::limit_exceeded, "root:" + std::string(path) + " names over " +
                                                   std::to_string(files_max) + " files");
    std::uint64_t left = bytes_max - (*main)->bytes.size();
    std::vector<SourceFile> files;
    files.push_back(std::move(**main));
    // The MTL files of an OBJ name others in turn, which go to the end of the list.
    std::deque<std::string> open(names.begin(), names.end());
    for (; !open.empty(); open.pop_front()) {
        const std::string& name = open.front();
        const auto is_it = [&](const SourceFile& file) { return file.name == name; };
        if (std::any_of(files.begin(), files.end(), is_it)) continue;
        auto file = read_under_root(root, folder, name, left, memory);
        if (!file) return tl::unexpected(file.error());
        // Skip a missing file; the import reports it if it needs it.
        if (!*file) continue;
        left -= (*file)->bytes.size();
        for (std::string& more : files_named_by(name, (*file)->bytes, files_max)) {
            if (has_extension(name, ".mtl")) open.push_back(std::move(more));
        }
        if (files.size() >= files_max)
            return fail(ErrorCode::limit_exceeded, "root:" + std::string(path) + " names over " +
                                                       std::to_string(files_max) + " files");
        files.push_back(std::move(**file));
    }
    return files;
}

}  // namespace raynest::server
