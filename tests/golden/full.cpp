#include "tests/golden/full.h"

#include <flatbuffers/reflection.h>

#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <utility>

namespace raynest::golden {
namespace {

using flatbuffers::uoffset_t;
using flatbuffers::voffset_t;
using reflection::BaseType;

/// messages.fbs as flatc compiles it.
const reflection::Schema& schema() {
    static const std::vector<char> bytes = [] {
        std::ifstream file(RAYNEST_SCHEMA, std::ios::binary);
        return std::vector<char>{std::istreambuf_iterator<char>(file), {}};
    }();
    return *reflection::GetSchema(bytes.data());
}

/// Items of lists of numbers and vectors: as many as a pose has, and a lidar channels.
constexpr std::size_t floats = 12;
const wire::Vec3 vector_of_ones(1, 1, 1);

/// Builds tables from the inside out, as FlatBuffers wants them.
class Builder {
public:
    explicit Builder(std::size_t spoilt) : spoilt_(spoilt) { builder_.ForceDefaults(true); }

    FullMessage build(wire::Message type, const reflection::Object& object) {
        builder_.Finish(flatbuffers::Offset<void>(table(object, "")));
        protocol::FrameHeader header;
        header.type = static_cast<std::uint16_t>(type);
        header.request_id = 1;
        return {protocol::seal(header, builder_, {}).value(), std::move(texts_)};
    }

private:
    uoffset_t text(const std::string& path) {
        texts_.push_back(path);
        return builder_.CreateString(texts_.size() - 1 == spoilt_ ? "a\x01" : "a=b").o;
    }

    uoffset_t list(const reflection::Type& type, const std::string& path) {
        const auto numbers = [&]<class Number>(Number one) {
            return builder_.CreateVector(std::vector<Number>{one}).o;
        };
        switch (type.element()) {
            case BaseType::String:
                return builder_.CreateVector(std::vector{flatbuffers::Offset<void>(text(path))}).o;
            case BaseType::Obj: {
                if (is_vector3(type))
                    return builder_.CreateVectorOfStructs(std::vector(floats, vector_of_ones)).o;
                const auto& element =
                    *schema().objects()->Get(static_cast<uoffset_t>(type.index()));
                return builder_
                    .CreateVector(std::vector{flatbuffers::Offset<void>(table(element, path))})
                    .o;
            }
            case BaseType::UByte: {
                // The only such list: a digest of one file
                constexpr std::size_t digest_bytes = 32;
                return builder_.CreateVector(std::vector(digest_bytes, std::uint8_t{1})).o;
            }
            case BaseType::UInt:
                return numbers(std::uint32_t{1});
            case BaseType::ULong:
                return numbers(std::uint64_t{1});
            case BaseType::Float:
                return builder_.CreateVector(std::vector(floats, 1.0F)).o;
            case BaseType::Double:
                return numbers(1.0);
            default:
                std::abort();  // a list of a kind that the schema did not have so far
        }
    }

    uoffset_t table(const reflection::Object& object, const std::string& path) {
        // FlatBuffers requires children to be complete before their table begins.
        std::vector<std::pair<voffset_t, uoffset_t>> children;
        for (const reflection::Field* field : *object.fields()) {
            const reflection::Type& type = *field->type();
            const std::string name = (path.empty() ? "" : path + ".") + field->name()->str();
            if (type.base_type() == BaseType::String)
                children.emplace_back(field->offset(), text(name));
            if (type.base_type() == BaseType::Vector && name != "blocks")
                children.emplace_back(field->offset(), list(type, name));
            if (type.base_type() == BaseType::Obj && !is_vector3(type))
                children.emplace_back(
                    field->offset(),
                    table(*schema().objects()->Get(static_cast<uoffset_t>(type.index())), name));
        }
        const uoffset_t start = builder_.StartTable();
        for (const auto& [offset, child] : children)
            builder_.AddOffset(offset, flatbuffers::Offset<void>(child));
        for (const reflection::Field* field : *object.fields()) add_number(*field);
        return builder_.EndTable(start);
    }

    void add_number(const reflection::Field& field) {
        // A query whose rays the daemon makes sends none, and a tile lies in a picture of one
        // pixel.
        const std::string_view name = field.name()->string_view();
        if (name == "ray_count" || name == "tile_x" || name == "tile_y") return;
        const auto add = [&]<class Number>(Number one) {
            builder_.AddElement<Number>(field.offset(), one, Number{});
        };
        switch (field.type()->base_type()) {
            case BaseType::Bool:
            case BaseType::UByte:
                return add(std::uint8_t{1});
            case BaseType::UShort:
                return add(std::uint16_t{1});
            case BaseType::UInt:
                return add(std::uint32_t{1});
            case BaseType::ULong:
                return add(std::uint64_t{1});
            case BaseType::Float:
                return add(1.0F);
            case BaseType::Double:
                return add(1.0);
            case BaseType::Obj:
                if (is_vector3(*field.type())) builder_.AddStruct(field.offset(), &vector_of_ones);
                return;
            case BaseType::String:
            case BaseType::Vector:
                return;
            default:
                std::abort();  // a number of a kind that the schema did not have so far
        }
    }

    /// The schema's only struct.
    static bool is_vector3(const reflection::Type& type) {
        return schema().objects()->Get(static_cast<uoffset_t>(type.index()))->is_struct();
    }

    flatbuffers::FlatBufferBuilder builder_;
    const std::size_t spoilt_;
    std::vector<std::string> texts_;
};

/// THE LIST: a number and its table, `use` for each.
template <class Use>
void each_message(Use use) {
    for (const reflection::Enum* list : *schema().enums()) {
        if (list->name()->string_view() != "raynest.wire.Message") continue;
        for (const reflection::EnumVal* value : *list->values())
            if (const reflection::Type* table = value->union_type();
                table != nullptr && value->value() != 0)
                use(static_cast<wire::Message>(value->value()),
                    *schema().objects()->Get(static_cast<uoffset_t>(table->index())));
    }
}

}  // namespace

std::vector<wire::Message> message_types() {
    std::vector<wire::Message> types;
    each_message([&](wire::Message type, const auto&) { types.push_back(type); });
    return types;
}

FullMessage full_message(wire::Message type, std::size_t spoilt) {
    FullMessage full;
    each_message([&](wire::Message listed, const reflection::Object& object) {
        if (listed == type) full = Builder(spoilt).build(type, object);
    });
    return full;
}

}  // namespace raynest::golden
