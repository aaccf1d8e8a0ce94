// bufferViews and accessors: every range is checked here once, then read without a check.
#include "engine/assets/gltf/file/model.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>

namespace raynest::gltf {
namespace {

bool component_of(int type, Component& component) {
    switch (type) {
        case 5120:
            component = Component::i8;
            return true;
        case 5121:
            component = Component::u8;
            return true;
        case 5122:
            component = Component::i16;
            return true;
        case 5123:
            component = Component::u16;
            return true;
        case 5125:
            component = Component::u32;
            return true;
        case 5126:
            component = Component::f32;
            return true;
        default:
            return false;
    }
}

bool is_unsigned(Component component) {
    return component == Component::u8 || component == Component::u16 || component == Component::u32;
}

/// glTF allows 252; this is more than any vertex has.
constexpr std::uint64_t stride_max = 65535;

tl::unexpected<Error> refuse(const std::string& why) {
    return fail(ErrorCode::scene_invalid, why);
}

/// Returns where `count` elements of `element` bytes at `offset` start in the view, or null if they
/// do not lie inside it. No sum or product here can wrap: every term is bounded before it is used.
const std::byte* place(const View& view, std::uint64_t offset, std::uint64_t count,
                       std::uint64_t stride, std::uint64_t element) {
    const std::uint64_t size = view.bytes.size();
    if (offset > size || element > size - offset) return nullptr;
    if (count - 1 > (size - offset - element) / stride) return nullptr;
    return view.bytes.data() + offset;
}

template <class T>
T load(const std::byte* at) {
    T value;
    std::memcpy(&value, at, sizeof value);
    return value;
}

float load_component(const std::byte* at, Component component, bool normalized) {
    switch (component) {
        case Component::i8: {
            const auto value = static_cast<float>(load<std::int8_t>(at));
            return normalized ? std::max(value / 127.0F, -1.0F) : value;
        }
        case Component::u8: {
            const auto value = static_cast<float>(load<std::uint8_t>(at));
            return normalized ? value / 255.0F : value;
        }
        case Component::i16: {
            const auto value = static_cast<float>(load<std::int16_t>(at));
            return normalized ? std::max(value / 32767.0F, -1.0F) : value;
        }
        case Component::u16: {
            const auto value = static_cast<float>(load<std::uint16_t>(at));
            return normalized ? value / 65535.0F : value;
        }
        case Component::u32:
            return static_cast<float>(load<std::uint32_t>(at));
        case Component::f32:
            break;
    }
    return load<float>(at);
}

std::uint32_t load_index(const std::byte* at, Component component) {
    if (component == Component::u8) return load<std::uint8_t>(at);
    if (component == Component::u16) return load<std::uint16_t>(at);
    return load<std::uint32_t>(at);
}

}  // namespace

Result<View> check_view(const RawView& raw, std::span<const Fetched> buffers) {
    if (raw.buffer < 0 || static_cast<std::uint64_t>(raw.buffer) >= buffers.size()) {
        return refuse(
            fmt::format("refers to buffer {}, but there are {}", raw.buffer, buffers.size()));
    }
    const Fetched& buffer = buffers[static_cast<std::size_t>(raw.buffer)];
    const auto bytes = std::as_bytes(std::span(buffer.bytes));
    if (raw.offset > bytes.size() || raw.length > bytes.size() - raw.offset || raw.length == 0) {
        return refuse(fmt::format("has {} bytes from byte {} on, outside its buffer of {} bytes",
                                  raw.length, raw.offset, bytes.size()));
    }
    if (raw.stride > stride_max)
        return refuse(fmt::format("has stride {}; at most {} is read", raw.stride, stride_max));
    return View{bytes.subspan(raw.offset, raw.length), raw.stride};
}

Result<Accessor> check_accessor(const RawAccessor& raw, std::span<const View> views) {
    Accessor out;
    if (!component_of(raw.component_type, out.component)) {
        return refuse(fmt::format("has the unknown component type {}", raw.component_type));
    }
    if (raw.width == 0) return refuse("has an unknown type or no valid count");
    if (raw.count > 0xFFFFFFFFU) return refuse("has a count that is negative or above 4294967295");
    if (raw.count == 0) {
        return refuse(fmt::format("has {} elements of {} components", raw.count, raw.width));
    }
    // Test this before the range: floats where indices belong are also too long for their
    // bufferView.
    if (raw.holds_indices && (raw.width != 1 || !is_unsigned(out.component) || raw.normalized)) {
        return refuse("holds indices that are not plain unsigned integers");
    }
    out.count = raw.count;
    out.width = raw.width;
    out.normalized = raw.normalized;
    out.scalar_or_vector = raw.scalar_or_vector;
    const std::uint32_t component = size_of(out.component);
    const std::uint32_t element = component * raw.width;
    out.stride = element;

    const auto view_of = [&](std::int64_t index) -> const View* {
        const bool known = index >= 0 && static_cast<std::uint64_t>(index) < views.size();
        return known ? &views[static_cast<std::size_t>(index)] : nullptr;
    };
    if (raw.view != -1) {
        const View* view = view_of(raw.view);
        if (view == nullptr) {
            return refuse(
                fmt::format("refers to bufferView {}, but there are {}", raw.view, views.size()));
        }
        if (view->stride != 0) out.stride = static_cast<std::uint32_t>(view->stride);
        out.misaligned = view->stride % 4 != 0;
        if (out.stride < element) {
            return refuse(fmt::format("has elements of {} bytes that overlap at stride {}", element,
                                      out.stride));
        }
        // glTF aligns relative to the start of the buffer, which the allocator aligns.
        const auto start = reinterpret_cast<std::uintptr_t>(view->bytes.data());
        out.misaligned =
            out.misaligned || (start + raw.offset) % component != 0 || out.stride % component != 0;
        out.data = place(*view, raw.offset, raw.count, out.stride, element);
        if (out.data == nullptr) {
            return refuse(
                fmt::format("has {} elements of {} bytes from byte {} on, outside its bufferView "
                            "of {} bytes",
                            raw.count, element, raw.offset, view->bytes.size()));
        }
    }

    if (raw.sparse) {
        const View* indices = view_of(raw.sparse_indices_view);
        const View* values = view_of(raw.sparse_values_view);
        const bool index_type = component_of(raw.sparse_component_type, out.sparse_component) &&
                                is_unsigned(out.sparse_component);
        if (indices == nullptr || values == nullptr || !indices->fault.empty() ||
            !values->fault.empty() || !index_type || raw.sparse_count < 1 ||
            static_cast<std::uint64_t>(raw.sparse_count) > raw.count ||
            raw.sparse_indices_offset < 0 || raw.sparse_values_offset < 0) {
            return refuse("is sparse and names bufferViews, types or counts that do not exist");
        }
        out.sparse_count = static_cast<std::uint64_t>(raw.sparse_count);
        const std::uint32_t index_size = size_of(out.sparse_component);
        out.sparse_indices = place(*indices, static_cast<std::uint64_t>(raw.sparse_indices_offset),
                                   out.sparse_count, index_size, index_size);
        out.sparse_values = place(*values, static_cast<std::uint64_t>(raw.sparse_values_offset),
                                  out.sparse_count, element, element);
        if (out.sparse_indices == nullptr || out.sparse_values == nullptr) {
            return refuse("is sparse and has elements outside their bufferViews");
        }
    }
    return out;
}

namespace {

/// Reads elements of an accessor into `out` by `read_element(from, to)`, `width` values each: those
/// listed in `elements`, or all if the list is empty.
template <class T, class ReadElement>
Result<std::vector<T>> read_elements(const Accessor& accessor,
                                     std::span<const std::uint32_t> elements,
                                     const ReadElement& read_element) {
    if (!accessor.fault.empty()) return refuse("needs " + accessor.fault);
    const std::uint32_t width = accessor.width;
    if (accessor.data == nullptr && accessor.count > zero_filled_max) {
        return fail(ErrorCode::limit_exceeded,
                    fmt::format("has an accessor of {} elements without a bufferView; at most {} "
                                "are allowed",
                                accessor.count, zero_filled_max));
    }
    if (accessor.sparse_count == 0) {
        const std::uint64_t count = elements.empty() ? accessor.count : elements.size();
        std::vector<T> out(count * width);
        for (std::uint64_t i = 0; accessor.data != nullptr && i < count; ++i) {
            const std::uint64_t element = elements.empty() ? i : elements[i];
            read_element(accessor.data + element * accessor.stride, out.data() + i * width);
        }
        return out;
    }

    // A sparse accessor is expanded in full, then its elements are selected.
    std::vector<T> full(accessor.count * width);
    for (std::uint64_t i = 0; accessor.data != nullptr && i < accessor.count; ++i) {
        read_element(accessor.data + i * accessor.stride, full.data() + i * width);
    }
    const std::uint64_t value_bytes = std::uint64_t{width} * size_of(accessor.component);
    for (std::uint64_t i = 0; i < accessor.sparse_count; ++i) {
        const std::uint32_t index =
            load_index(accessor.sparse_indices + i * size_of(accessor.sparse_component),
                       accessor.sparse_component);
        if (index >= accessor.count) {
            return refuse(fmt::format("has a sparse accessor that replaces element {} of {}", index,
                                      accessor.count));
        }
        read_element(accessor.sparse_values + i * value_bytes,
                     full.data() + std::uint64_t{index} * width);
    }
    if (elements.empty()) return full;
    std::vector<T> out(elements.size() * width);
    for (std::size_t i = 0; i < elements.size(); ++i) {
        std::copy_n(full.data() + std::uint64_t{elements[i]} * width, width,
                    out.data() + i * width);
    }
    return out;
}

}  // namespace

Result<std::vector<float>> read_floats(const Accessor& accessor,
                                       std::span<const std::uint32_t> elements) {
    const std::size_t component = size_of(accessor.component);
    return read_elements<float>(accessor, elements, [&](const std::byte* from, float* to) {
        for (std::uint32_t c = 0; c < accessor.width; ++c) {
            to[c] = load_component(from + c * component, accessor.component, accessor.normalized);
        }
    });
}

Result<std::vector<std::uint32_t>> read_indices(const Accessor& accessor) {
    return read_elements<std::uint32_t>(accessor, {},
                                        [&](const std::byte* from, std::uint32_t* to) {
                                            *to = load_index(from, accessor.component);
                                        });
}

}  // namespace raynest::gltf
