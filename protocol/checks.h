// Makes validate.cpp a list: one line per field, and the first complaint wins.
//
// Private to the protocol library.
#pragma once

#include "protocol/errors.h"
#include "protocol/limits.h"
#include "protocol/validate.h"
#include "protocol/wire.h"

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>

namespace raynest::protocol {

/// Collects the first complaint about a message, so that the checks below read as a list.
class Checks {
public:
    using String = flatbuffers::String;
    using Strings = flatbuffers::Vector<flatbuffers::Offset<String>>;
    template <class T>
    using Vector = flatbuffers::Vector<T>;

    explicit Checks(const Limits& limits) : limits_(limits) {}

    Checks& name(const char* field, const String* value) {
        return string(field, value, limits_.name_bytes_max, "name_bytes_max");
    }
    Checks& text(const char* field, const String* value) {
        return string(field, value, limits_.text_bytes_max, "text_bytes_max");
    }
    Checks& needs(const char* field, const String* value) {
        if (value == nullptr || value->size() == 0)
            complain(Code::invalid_field, field, "is missing");
        return *this;
    }
    /// A name that must be there.
    Checks& named(const char* field, const String* value) {
        return name(field, value).needs(field, value);
    }
    Checks& names(const char* field, const Strings* list) {
        items(field, list);
        if (!error_ && list != nullptr)
            for (const String* item : *list) name(field, item);
        return *this;
    }
    Checks& texts(const char* field, const Strings* list) {
        items(field, list);
        if (!error_ && list != nullptr)
            for (const String* item : *list) text(field, item);
        return *this;
    }
    /// "name=value" each.
    Checks& settings(const char* field, const Strings* list, std::uint64_t bytes_max,
                     const char* limit) {
        items(field, list);
        if (!error_ && list != nullptr)
            for (const String* item : *list)
                string(field, item, bytes_max, limit)
                    .that(item->string_view().find('=') != std::string_view::npos, field,
                          "must read name=value");
        return *this;
    }
    /// Tables with names and at most `table_values_max` values in all.
    Checks& tables(const char* field, const Vector<flatbuffers::Offset<wire::ParamTable>>* list) {
        items(field, list);
        if (error_ || list == nullptr) return *this;
        std::uint64_t values = 0;  // the lists of one message cannot wrap it
        for (const wire::ParamTable* table : *list) {
            named(field, table->name());
            if (table->values() != nullptr) values += table->values()->size();
        }
        return at_most(field, values, limits_.table_values_max, "table_values_max");
    }
    template <class T>
    Checks& items(const char* field, const Vector<T>* list) {
        return at_most(field, size(list), limits_.list_items_max, "list_items_max");
    }
    /// One number for each item of `list`. FlatBuffers aligns the length of a vector, but up
    /// to 2.0.8 does not verify that elements of 8 bytes are aligned as well.
    template <class Number>
    Checks& numbers(const char* field, const Strings* list, const Vector<Number>* numbers) {
        if (size(list) != size(numbers))
            complain(Code::invalid_field, field, "lists differ in length");
        return aligned(field, numbers, size(numbers), "");
    }
    template <class Number>
    Checks& aligned(const char* field, const Vector<Number>* numbers, std::uint64_t most,
                    const char* limit) {
        at_most(field, size(numbers), most, limit);
        if (numbers != nullptr &&
            reinterpret_cast<std::uintptr_t>(numbers->Data()) % sizeof(Number) != 0)
            complain(Code::bad_frame, field, "numbers are not aligned");
        return *this;
    }
    /// SHA-256 digests one after the other: one for each of the list, or none.
    Checks& digests(const char* field, const Strings* list, const Vector<std::uint8_t>* bytes) {
        constexpr std::size_t digest_bytes = 32;
        if (size(bytes) != 0 && size(bytes) != digest_bytes * size(list))
            complain(Code::invalid_field, field, "is not 32 bytes for each file");
        return *this;
    }
    Checks& equally_long(const char* field, const Strings* a, const Strings* b) {
        if (size(a) != size(b)) complain(Code::invalid_field, field, "lists differ in length");
        return *this;
    }
    Checks& at_most(const char* field, std::uint64_t value, std::uint64_t most, const char* limit) {
        if (value > most)
            complain(
                Code::limit_exceeded, field,
                "is " + std::to_string(value) + ", over " + limit + " = " + std::to_string(most));
        return *this;
    }
    Checks& at_least(const char* field, std::uint64_t value, std::uint64_t least) {
        if (value < least)
            complain(Code::invalid_field, field, "must be at least " + std::to_string(least));
        return *this;
    }
    Checks& finite(const char* field, double value) {
        if (!std::isfinite(value)) complain(Code::invalid_field, field, "is not finite");
        return *this;
    }
    Checks& finite(const char* field, const wire::Vec3* value) {
        if (value == nullptr) return *this;
        return finite(field, static_cast<double>(value->x()))
            .finite(field, static_cast<double>(value->y()))
            .finite(field, static_cast<double>(value->z()));
    }
    Checks& that(bool holds, const char* field, const char* why) {
        if (!holds) complain(Code::invalid_field, field, why);
        return *this;
    }
    /// Applies the checks of a nested table.
    template <class Table>
    Checks& nested(const Table* table, void (*check)(Checks&, const Table&)) {
        if (table != nullptr && !error_) check(*this, *table);
        return *this;
    }

    /// Has nothing been complained about? Then lists may be walked.
    [[nodiscard]] bool good() const { return !error_; }
    [[nodiscard]] const Limits& limits() const { return limits_; }
    [[nodiscard]] Result<void> result() {
        if (error_) return tl::unexpected<Error>(std::move(*error_));
        return {};
    }

private:
    template <class T>
    static std::uint64_t size(const Vector<T>* list) {
        return list != nullptr ? list->size() : 0;
    }
    void complain(Code code, const char* field, const std::string& what) {
        if (!error_) error_ = Error{code, std::string(field) + " " + what, 0};
    }
    Checks& string(const char* field, const String* value, std::uint64_t most, const char* limit) {
        if (value == nullptr || error_) return *this;
        at_most(field, value->size(), most, limit);
        if (!error_ && !printable(value->string_view()))
            error_ = Error{Code::invalid_field,
                           std::string("`").append(field).append("` is not printable UTF-8"), 0};
        return *this;
    }

    const Limits& limits_;
    std::optional<Error> error_;
};

}  // namespace raynest::protocol
