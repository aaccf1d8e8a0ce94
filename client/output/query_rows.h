// Prints the answer of a query on stdout: an aligned table, or one JSON object per ray.
#pragma once

#include "client/requests/query.h"

#include <string>
#include <vector>

namespace raynest::client {

class QueryRows {
public:
    /// `fields` are in the order of the output. A ray of a closest query is a miss if the column
    /// `hit` is 0; that column is shown only if it is among `fields`.
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

/// Prints rows of a reduced answer: all columns, in the daemon's order.
class ReducedRows {
public:
    /// `number` is the title of a column with row numbers; empty: no such column.
    ReducedRows(std::string number, bool json);

    Result<void> print(const QueryChunk& chunk);

private:
    std::string number_;
    bool json_;
    bool titled_ = false;
};

}  // namespace raynest::client
