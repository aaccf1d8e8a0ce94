// Inputs for the asset tests: writers of small GLB files and raw PNG files, and access to the
// shared scenes, which are beside the repository and may be absent.
#pragma once

#include "engine/assets/images/image.h"
#include "engine/assets/input/import_request.h"

#include <doctest/doctest.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

namespace raynest::test {

using Bytes = std::vector<std::byte>;

inline Bytes to_bytes(const std::string& text) {
    const auto view = std::as_bytes(std::span(text));
    return {view.begin(), view.end()};
}

inline Bytes read_file(const std::filesystem::path& path) {
    std::ifstream file(path, std::ios::binary);
    Bytes bytes(std::filesystem::file_size(path));
    file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    return bytes;
}

/// True if the shared scenes exist; prints a message if not. For the suite "shared scenes".
inline bool have_shared_scenes() {
    if (std::filesystem::exists(std::filesystem::path(RAYNEST_SHARED_SCENES) / "expected.json"))
        return true;
    MESSAGE("skipped: no shared scenes at " RAYNEST_SHARED_SCENES);
    return false;
}

/// True if this build decodes pictures; prints a message if not. For the suite "images".
inline bool have_images() {
    if (images_available()) return true;
    MESSAGE("skipped: no images, this build lacks OpenImageIO");
    return false;
}

inline std::filesystem::path shared_scene(const std::string& name) {
    return std::filesystem::path(RAYNEST_SHARED_SCENES) / name;
}

/// An upload: a scene file and, for a .gltf, the other files of its folder. Owns the bytes.
class Upload {
public:
    explicit Upload(const std::filesystem::path& path) {
        add(path);
        request_.source = path.filename().string();
        if (path.extension() != ".gltf") return;
        for (const auto& entry : std::filesystem::directory_iterator(path.parent_path())) {
            const auto extension = entry.path().extension();
            if (entry.is_regular_file() && extension != ".gltf" && extension != ".glb")
                add(entry.path());
        }
    }
    Upload(const std::string& name, Bytes bytes) {
        request_.source = name;
        add(name, std::move(bytes));
    }
    void add(const std::string& name, Bytes bytes) {
        bytes_.push_back(std::move(bytes));
        request_.files.push_back({name, bytes_.back()});
    }
    /// Returns the same upload with only the first bytes of the main file.
    [[nodiscard]] ImportRequest cut(std::size_t length) const {
        ImportRequest request = request_;
        request.files[0].bytes = request.files[0].bytes.first(length);
        return request;
    }
    [[nodiscard]] const ImportRequest& request() const { return request_; }

private:
    void add(const std::filesystem::path& path) { add(path.filename().string(), read_file(path)); }

    std::vector<Bytes> bytes_;
    ImportRequest request_;
};

/// Writes GLB files: add accessors, then refer to them in the members of the JSON text.
class GlbWriter {
public:
    /// Adds an accessor. `type` is "VEC3" etc., `component` is glTF's number. Returns its index.
    template <class T>
    int add(const std::vector<T>& values, const char* type, int component, std::size_t width,
            const std::string& extra = {}) {
        while (binary_.size() % 4 != 0) binary_.push_back('\0');
        const std::size_t size = values.size() * sizeof(T);
        const std::size_t at = binary_.size();
        binary_.resize(at + size);
        std::memcpy(binary_.data() + at, values.data(), size);
        separate(views_) += "{\"buffer\":0,\"byteOffset\":" + std::to_string(at) +
                            ",\"byteLength\":" + std::to_string(size) + "}";
        separate(accessors_) += "{\"bufferView\":" + std::to_string(count_) +
                                ",\"componentType\":" + std::to_string(component) +
                                ",\"count\":" + std::to_string(values.size() / width) +
                                ",\"type\":\"" + type + "\"" + extra + "}";
        return count_++;
    }
    int add_floats(const std::vector<float>& values, const char* type, std::size_t width) {
        return add(values, type, 5126, width);
    }
    int add_indices(const std::vector<std::uint16_t>& values) {
        return add(values, "SCALAR", 5123, 1);
    }

    /// Returns the file. `members` are further top-level members, e.g. "\"nodes\":[{}]".
    [[nodiscard]] Bytes glb(const std::string& members) const {
        std::string json = R"({"asset":{"version":"2.0"},)" + members;
        if (count_ != 0) {
            json += ",\"bufferViews\":[" + views_ + "],\"accessors\":[" + accessors_ +
                    "],\"buffers\":[{\"byteLength\":" + std::to_string(binary_.size()) + "}]";
        }
        json += '}';
        while (json.size() % 4 != 0) json += ' ';
        std::string binary = binary_;
        while (binary.size() % 4 != 0) binary.push_back('\0');
        std::string file = "glTF" + word(2) + word(12 + 8 + json.size() + 8 + binary.size());
        file += word(json.size()) + "JSON" + json + word(binary.size()) + std::string("BIN\0", 4) +
                binary;
        return to_bytes(file);
    }

private:
    static std::string word(std::size_t value) {
        std::string text(4, '\0');
        const auto narrow = static_cast<std::uint32_t>(value);
        std::memcpy(text.data(), &narrow, 4);
        return text;
    }
    static std::string& separate(std::string& list) { return list.empty() ? list : list += ','; }

    std::string binary_;
    std::string views_;
    std::string accessors_;
    int count_ = 0;
};

/// Returns one triangle in the plane z = 0; the caller adds nodes and more.
inline std::string one_triangle_mesh(GlbWriter& writer) {
    const int position = writer.add_floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3);
    return "\"meshes\":[{\"name\":\"leaf\",\"primitives\":[{\"attributes\":{\"POSITION\":" +
           std::to_string(position) + "}}]}]";
}

/// Returns a PNG with stored (uncompressed) rows, of any colour type and depth; `rows` includes the
/// filter byte of each row. The header gets `announced_*`, which a bomb states falsely.
inline Bytes raw_png(std::uint32_t announced_width, std::uint32_t announced_height, int bit_depth,
                     int colour_type, const std::string& rows, const std::string& palette = {}) {
    const auto big = [](std::uint32_t value) {
        std::string text;
        for (int shift = 24; shift >= 0; shift -= 8)
            text += static_cast<char>(value >> shift & 0xFF);
        return text;
    };
    const auto chunk = [&](const std::string& type, const std::string& payload) {
        std::uint32_t crc = 0xFFFFFFFFU;
        for (const char c : type + payload) {
            crc ^= static_cast<unsigned char>(c);
            for (int bit = 0; bit < 8; ++bit)
                crc = (crc >> 1) ^ ((crc & 1U) != 0 ? 0xEDB88320U : 0U);
        }
        return big(static_cast<std::uint32_t>(payload.size())) + type + payload + big(~crc);
    };
    std::uint32_t a = 1;
    std::uint32_t b = 0;
    for (const char c : rows) {
        a = (a + static_cast<unsigned char>(c)) % 65521;
        b = (b + a) % 65521;
    }
    const auto size = static_cast<std::uint32_t>(rows.size());
    std::string stored = "\x78\x01\x01";
    for (const std::uint32_t value : {size, ~size}) {
        stored += static_cast<char>(value & 0xFF);
        stored += static_cast<char>(value >> 8 & 0xFF);
    }
    stored += rows + big(b << 16 | a);
    std::string header = big(announced_width) + big(announced_height);
    header += static_cast<char>(bit_depth);
    header += static_cast<char>(colour_type);
    header += std::string(3, '\0');
    std::string file = "\x89PNG\r\n\x1A\n" + chunk("IHDR", header);
    if (!palette.empty()) file += chunk("PLTE", palette);
    return to_bytes(file + chunk("IDAT", stored) + chunk("IEND", {}));
}

}  // namespace raynest::test
