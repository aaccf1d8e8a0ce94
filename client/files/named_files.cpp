#include "client/files/named_files.h"

#include "client/files/files.h"
#include "client/files/gltf_names.h"
#include "client/files/obj_names.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <set>

namespace raynest::client {
namespace {

using Names = Result<std::vector<NamedFile>>;
using nlohmann::json;

/// Collects the texts of the members `file` and `matrices`, wherever they stand.
class FileCollector : public json::json_sax_t {
public:
    std::vector<std::string> names;

    bool null() override { return true; }
    bool boolean(bool) override { return true; }
    bool number_integer(number_integer_t) override { return true; }
    bool number_unsigned(number_unsigned_t) override { return true; }
    bool number_float(number_float_t, const string_t&) override { return true; }
    bool binary(binary_t&) override { return true; }
    bool string(string_t& text) override {
        if (key_ == "file" || key_ == "matrices") names.push_back(text);
        return true;
    }
    bool key(string_t& name) override {
        key_ = name;
        return true;
    }
    bool start_object(std::size_t) override { return enter(); }
    bool start_array(std::size_t) override { return enter(); }
    bool end_object() override { return --depth_ > 0; }
    bool end_array() override { return --depth_ > 0; }
    bool parse_error(std::size_t, const std::string&, const nlohmann::detail::exception&) override {
        return false;
    }

private:
    bool enter() {
        key_.clear();
        return ++depth_ <= json_depth_max;
    }
    std::size_t depth_ = 0;
    std::string key_;
};

Names of_gltf(const std::string& file, std::span<const std::byte> bytes) {
    if (const std::string why = why_no_gltf(bytes, extension_of(file) == ".glb"); !why.empty())
        return fail(Exit::invalid, why);
    const auto text = gltf_json(bytes);
    if (!text) return tl::unexpected<Failure>(text.error());
    const auto found = gltf_names(*text);
    if (!found) return tl::unexpected<Failure>(found.error());
    const std::string folder = file.substr(0, file.rfind('/') + 1);
    std::vector<NamedFile> names;
    for (const auto& [name, is_picture] : *found)
        names.push_back({folder + name, is_picture ? "picture" : ""});
    return names;
}

Names of_composition(const std::string& file, std::span<const std::byte> bytes) {
    FileCollector collector;
    const char* begin = reinterpret_cast<const char*>(bytes.data());
    json::sax_parse(begin, begin + std::min<std::size_t>(bytes.size(), json_bytes_max), &collector);
    std::vector<NamedFile> names;
    std::set<std::string> known;
    for (const std::string& text : collector.names)
        if (auto name = file_of_name(file, text); name && known.insert(*name).second)
            names.push_back({std::move(*name), ""});
    return names;
}

}  // namespace

Names named_files(const std::string& file, std::span<const std::byte> bytes) {
    const std::string ending = extension_of(file);
    if (ending == ".glb" || ending == ".gltf") return of_gltf(file, bytes);
    if (file.ends_with(composition_ending)) return of_composition(file, bytes);
    std::vector<NamedFile> names;
    for (std::string& name : obj_names(file, bytes)) names.push_back({std::move(name)});
    return names;
}

}  // namespace raynest::client
