// Opening the module of a pack: it has the doors that are looked for, and they are of this tree.
#pragma once

#include "engine/packs/device.h"
#include "engine/result.h"

#include <filesystem>
#include <span>
#include <string_view>
#include <vector>

namespace raynest {

/// Stays loaded: its functions are in use for the life of the process. pack_invalid, with what to
/// do, where it is no pack of this tree; says nothing about whether this machine runs it.
Result<const Pack*> load_pack(const std::filesystem::path& path);

/// The first type of the door that a pack with these layouts knows differently, or that only one
/// side knows; empty where all are alike.
std::string_view differing_type(std::span<const TypeLayout> theirs);

/// The files in this folder that are loaded as packs, in order of their names.
Result<std::vector<std::filesystem::path>> packs_in(const std::filesystem::path& folder);

/// Both doors of a pack for a device.
struct DevicePack {
    const Pack* pack = nullptr;
    const Device* device = nullptr;
};
Result<DevicePack> load_device_pack(const std::filesystem::path& path);

}  // namespace raynest
