// The table of file formats besides glTF. A new format is one file and one line in formats.cpp.
//
// All readers get bytes from outside: each count in a file is checked against the bytes that are
// there before anything is allocated for it, so memory is linear in the file. The readers are
// RayNest's own, over std::from_chars. Debian's tinyobjloader takes "1,5" and "x" for numbers and
// rounds a third of float64 numbers wrongly; Assimp reads float32, which loses surveyed digits; and
// Debian has no maintained library for PLY, STL or OFF.
#pragma once

#include "engine/assets/formats/file_content.h"
#include "engine/assets/input/import_request.h"
#include "engine/result.h"

#include <string>
#include <string_view>

namespace raynest {

using ReadFile = Result<FileContent> (*)(const ImportRequest&, const ImportLimits&);

struct FileFormat {
    std::string_view extension;  ///< ".ply"
    ReadFile read;               ///< for a request whose first file is not empty
};

/// Returns the format of a source by its ending, in upper or lower case; null if there is none.
[[nodiscard]] const FileFormat* find_format(std::string_view source);

/// Returns ".ply, .stl, ...", for messages.
[[nodiscard]] std::string format_list();

// Errors have one line without the file's name.

/// PLY, ASCII and binary: a mesh of polygons with normals and colours, or, if
/// it has no faces, points with a property "radius" or the request's radius.
Result<FileContent> read_ply(const ImportRequest& request, const ImportLimits& limits);
/// STL, ASCII and binary. Triangle i is facet i; vertices are not merged. An ASCII file has one
/// object per solid.
Result<FileContent> read_stl(const ImportRequest& request, const ImportLimits& limits);
/// OBJ with the MTL files and pictures of the request. One object per "o" or "g", one geometry per
/// material in it.
Result<FileContent> read_obj(const ImportRequest& request, const ImportLimits& limits);
/// OFF in ASCII, with the normals and colours of NOFF and COFF.
Result<FileContent> read_off(const ImportRequest& request, const ImportLimits& limits);
/// NumPy's .npz with the arrays "vertices" (N, 3) and "faces" (M, 3).
Result<FileContent> read_npz(const ImportRequest& request, const ImportLimits& limits);
/// LAS 1.0 to 1.4: points alone, with the request's radius.
Result<FileContent> read_las(const ImportRequest& request, const ImportLimits& limits);
/// Refuses LAZ with the remedy.
Result<FileContent> read_laz(const ImportRequest& request, const ImportLimits& limits);
/// TIFF of one band, with its place on the map if it is a GeoTIFF: east is +x, north is -z, or with
/// z up the map's own +y. An origin is chosen unless the request has one.
Result<FileContent> read_tiff(const ImportRequest& request, const ImportLimits& limits);
/// A .npy of shape (rows, columns): heights over a grid. Column i lies at x = i * spacing, row j at
/// z = j * spacing, and y is the height; with z up row j lies at y = -j * spacing. Cells with a
/// corner that is NaN are holes.
Result<FileContent> read_heights(const ImportRequest& request, const ImportLimits& limits);

}  // namespace raynest
