#include "server/options/load_sources.h"

#include <glob.h>

namespace raynest::server {

std::vector<std::string> files_of(const std::string& source) {
    if (source.starts_with("builtin:") || source.starts_with("root:")) return {source};
    glob_t found{};
    std::vector<std::string> files;
    if (glob(source.c_str(), 0, nullptr, &found) == 0)
        for (std::size_t i = 0; i < found.gl_pathc; ++i) files.emplace_back(found.gl_pathv[i]);
    globfree(&found);
    return files;
}

}  // namespace raynest::server
