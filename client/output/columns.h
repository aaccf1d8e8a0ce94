// Joins the chunks of an answer to whole columns, and makes files of them.
#pragma once

#include "client/requests/query.h"

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {

class Columns {
public:
    /// `splits`: rays have any number of hits, as those of kind multi.
    explicit Columns(bool splits) : has_splits_(splits) {}

    /// Fails with exit code 1 if a column changes its type.
    Result<void> append(const QueryChunk& chunk);

    /// Adds the columns of a reducer that has found nothing and so sent no chunk: empty ones.
    void complete(std::string_view reducer);

    /// The .npz of the columns that users asked for; `part` becomes an array of its letters, unless
    /// it is empty.
    [[nodiscard]] std::vector<std::byte> npz(std::string_view part) const;

    /// The points that were hit as a .ply, .pcd or .las, with the other columns beside them; of
    /// several hits of a ray also which (`return`, from 0) of how many (`returns`). Exit code 2 if
    /// the file cannot hold a column.
    [[nodiscard]] Result<std::vector<std::byte>> points(std::string_view ending) const;

private:
    struct Column {
        wire::Dtype dtype = wire::Dtype::u8;
        std::uint32_t width = 1;
        std::uint64_t count = 0;
        std::vector<std::byte> bytes;
        bool is_world = false;  ///< a point: float64
        std::string numpy;      ///< NumPy's dtype of its values
        std::size_t value_bytes = 1;
        bool shown = true;
    };

    void append_points(const QueryChunk& chunk, const protocol::BlockView& block, Column& column);
    [[nodiscard]] std::vector<std::uint64_t> hit_rows() const;  ///< rows of column position

    bool has_splits_;
    std::map<std::string, Column, std::less<>> columns_;
    std::vector<std::string> order_;  ///< as they came
    std::vector<std::uint64_t> splits_ = {0};
};

}  // namespace raynest::client
