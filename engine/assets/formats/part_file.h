// The files from which a scene's parts came, made again from the scene, so that a client that wants
// to load one of them in another scene need not send it.
//
//   .bin   the buffer of a glTF with one mesh: positions, then indices     objects of one geometry
//   .ply   binary: float x y z, faces as a list of three uint              objects of one geometry
//   .npy   a row of float32 for each record                                objects of records
//
// A file that other programs wrote may have the same content in other bytes; the Python client
// writes these.
#pragma once

#include "engine/geometry/views.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

namespace raynest {

/// One of these files. It refers to the scene's memory, which must outlive it. Thread-safe.
class PartFile {
public:
    /// Passes the bytes of the file one behind the other. Ends early where it returns false.
    using Sink = std::function<bool(std::span<const std::byte>)>;

    [[nodiscard]] std::uint64_t bytes() const;
    /// Linear in the file; needs no memory that grows with it. Pieces have at most 1 MiB.
    void write(const Sink& sink) const;

private:
    friend std::vector<PartFile> part_files(const SceneView& view, const ObjectRecord& object);
    enum class Form : std::uint8_t { bin, ply, npy };
    PartFile(Form form, const SceneView& view, const ObjectRecord& object);

    Form form_;
    const SceneView* view_;
    const ObjectRecord* object_;
    const GeometryRecord* geometry_;  ///< null for records
    std::string head_;
};

/// Smaller files are not worth a search.
inline constexpr std::uint64_t part_bytes_min = 4096;

/// The files that an object may have been made of; none for a small one.
[[nodiscard]] std::vector<PartFile> part_files(const SceneView& view, const ObjectRecord& object);

}  // namespace raynest
