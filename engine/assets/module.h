// Modules of the engine: code with heavy libraries that most processes never need.
#pragma once

#include "engine/result.h"

#include <cstddef>

namespace raynest {

struct Module {
    const char* file;    ///< found by the program's run path: in images/ below the kernel packs
    const char* symbol;  ///< the one that it exports
    std::size_t bytes;   ///< address space that it takes with its libraries
    const char* need;    ///< starts the message where it cannot be loaded: "pictures need ..."
    const char* remedy;  ///< ends it: "install ..."
};

/// The module's symbol. Loads the module once and never closes it; thread-safe.
Result<void*> load_module(const Module& module);

}  // namespace raynest
