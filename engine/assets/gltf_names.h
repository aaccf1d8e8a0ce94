// Names that come out of a scene file: how they are shown, and which files they may reach.
#pragma once

#include "engine/assets/import.h"
#include "engine/result.h"
#include "engine/scene/description.h"

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace raynest::gltf {

/// The uploaded file that a URI stands for: percent-decoded once, "./" dropped, "a/.." cancelled.
/// Nothing where the URI has a scheme, is absolute, leaves the scene's folder, or hides a dot or a
/// separator behind a percent sign. Clients apply the same rule (tests/golden/gltf_uris.txt).
[[nodiscard]] std::optional<std::string> file_of_uri(std::string_view uri);

/// The first bytes of UTF-8 text, at most `bytes_max`, without a part of a character.
[[nodiscard]] std::string_view front_of(std::string_view text, std::size_t bytes_max);

/// Foreign text for a message: control characters become spaces, and it ends before it bores.
[[nodiscard]] std::string one_line(std::string_view text, std::size_t length_max = 160);

/// "mesh 7 ('leaf')", or "mesh 7" when it has no name.
[[nodiscard]] std::string label(std::string_view kind, std::uint64_t index, std::string_view name);

/// Counts one more `kind` that is left out. The first few are warned about, the rest only counted:
/// a file of millions of them is no longer to read than one of ten.
void leave_out(SceneDescription& scene, const std::string& kind, std::string why);

/// The uploaded files as a loader sees them: by exact name, and only so many bytes in total. (A
/// scene that names one file a thousand times is made to cost memory.)
class Upload {
public:
    Upload(const ImportRequest& request, std::uint64_t bytes_max)
        : request_(request),
          bytes_left_(bytes_max) {}

    /// The file's bytes; without data where it did not come. limit_exceeded when the scene reads
    /// more than `bytes_max`.
    Result<std::span<const std::byte>> read(std::string_view name);

private:
    const ImportRequest& request_;
    std::uint64_t bytes_left_;
};

}  // namespace raynest::gltf
