// Reads the file names of a hostile glTF as the client does: each must be a path beneath its
// folder.
#include "client/files/named_files.h"
#include "tests/fuzz/target.h"

#include <string>

using namespace raynest;

namespace {

fuzz::Input input_of(const std::string& text) {
    return {text.begin(), text.end()};
}

std::string glb_of(const std::string& json) {
    const auto word = [](std::size_t value) {
        std::string bytes;
        for (int i = 0; i < 4; ++i) bytes += static_cast<char>(value >> (8 * i) & 0xFF);
        return bytes;
    };
    return "glTF" + word(2) + word(20 + json.size()) + word(json.size()) + "JSON" + json;
}

}  // namespace

std::vector<fuzz::Input> fuzz::seeds() {
    const std::string json =
        R"({"asset":{"version":"2.0"},"buffers":[{"uri":"a%20b.bin","byteLength":36}],)"
        R"("images":[{"uri":"t/leaf.png"},{"uri":"data:image/png;base64,AAAA"},{"bufferView":0}],)"
        R"("nodes":[{"extras":{"uri":"no","list":[1,2.5,true,null,"x"]}}]})";
    return {
        input_of(json), input_of(glb_of(json)), input_of("{\"buffers\":[{\"uri\":\"../x\"}]}"),
        input_of(
            R"({"rnscene":1,"objects":{"a":{"file":"./b%20/../c.obj"}},"instances":[{"matrices":"m.npy"}]})"),
        input_of("mtllib a b.mtl\nmap_Kd -s 1 1 c.png\n")};
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const std::span bytes(reinterpret_cast<const std::byte*>(data), size);
    for (const char* file : {"x.gltf", "a/x.glb", "a/x.rnscene.json", "a b/x.obj", "x.mtl"}) {
        const auto names = client::named_files(file, bytes);
        if (!names) continue;
        for (const auto& [name, spare] : *names) {
            const std::string path = "/" + name + "/";
            fuzz::require(!name.empty() && name.front() != '/');
            fuzz::require(path.find("/../") == std::string::npos);
            fuzz::require(path.find("//") == std::string::npos);
            fuzz::require(name.find('\0') == std::string::npos);
        }
    }
    return 0;
}
