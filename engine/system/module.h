// Loadable modules of the engine: code with heavy libraries that most processes never need.
#pragma once

#include "engine/result.h"

#include <cstddef>

namespace raynest {

struct Module {
    const char* file;    ///< file in images/ below the kernel packs; the run path finds it
    const char* symbol;  ///< the only exported symbol
    std::size_t bytes;   ///< address space needed, with its libraries
    const char* need;    ///< starts the message when loading fails: "pictures need ..."
    const char* remedy;  ///< ends that message: "install ..."
};

/// Returns the module's symbol. Loads the module once and never closes it; thread-safe.
Result<void*> load_module(const Module& module);

}  // namespace raynest
