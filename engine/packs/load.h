// Opens the module of a pack: it must export the entry points, with the ABI of this source tree.
#pragma once

#include "engine/packs/device.h"
#include "engine/result.h"

#include <filesystem>
#include <span>
#include <string_view>
#include <vector>

namespace raynest {

/// Loads a pack for the life of the process. Fails with pack_invalid and a remedy if the file is no
/// pack of this source tree. Does not check whether this machine can run it.
Result<const Pack*> load_pack(const std::filesystem::path& path);

/// Loads a module for the life of the process and returns the address of a symbol that it exports;
/// fails as load_pack() does.
Result<void*> load_symbol(const std::filesystem::path& path, const char* symbol);

/// Returns the first type of the ABI that a pack with these layouts lays out differently, or that
/// only one side has; empty if all agree.
std::string_view differing_type(std::span<const TypeLayout> theirs);

/// Returns the files in this folder that are loaded as packs, ordered by name.
Result<std::vector<std::filesystem::path>> packs_in(const std::filesystem::path& folder);

/// Both tables of a pack for a device.
struct DevicePack {
    const Pack* pack = nullptr;
    const Device* device = nullptr;
};
Result<DevicePack> load_device_pack(const std::filesystem::path& path);

}  // namespace raynest
