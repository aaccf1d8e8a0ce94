// Query answers as rows on stdout: an aligned table, or one JSON object per ray.
#pragma once

#include "client/query.h"

#include <string>
#include <vector>

namespace raynest::client {

class QueryRows {
public:
    /// `fields` in the order in which they are shown. A ray of a closest query is a miss where the
    /// column `hit` is 0; that column is shown only when it is among `fields`.
    QueryRows(std::string kind, std::vector<std::string> fields, bool json);

    /// Prints the chunk's rays.
    Result<void> print(const QueryChunk& chunk);

private:
    struct Column;
    [[nodiscard]] std::vector<Column> columns_of(const QueryChunk& chunk) const;
    void print_json_ray(const QueryChunk& chunk, const std::vector<Column>& columns,
                        std::uint32_t ray) const;
    void print_titles(const std::vector<Column>& columns);
    void print_table_ray(const QueryChunk& chunk, const std::vector<Column>& columns,
                         std::uint32_t ray) const;

    std::string kind_;
    std::vector<std::string> fields_;
    bool json_;
    bool titled_ = false;
};

/// Rows of a reduced answer, which are neither rays nor hits: every column, in the daemon's order.
class ReducedRows {
public:
    /// `number` is the title of the rows' numbers; empty where the columns say what a row is of.
    ReducedRows(std::string number, bool json);

    Result<void> print(const QueryChunk& chunk);

private:
    std::string number_;
    bool json_;
    bool titled_ = false;
};

}  // namespace raynest::client
