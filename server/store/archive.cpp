#include "server/store/archive.h"

#include "engine/scene/digest.h"
#include "server/store/manifest.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <string_view>
#include <utility>

namespace raynest::server {
namespace {

/// The fields of a head (POSIX.1-1988, "ustar"): offset and bytes.
struct Field {
    std::size_t at, bytes;
};
constexpr Field name_field{0, 100}, mode_field{100, 8}, owner_field{108, 8}, group_field{116, 8},
    size_field{124, 12}, time_field{136, 12}, sum_field{148, 8}, magic_field{257, 8};
constexpr std::size_t type_at = 156;
constexpr std::byte base_256{0x80};
constexpr std::string_view magic{
    "ustar\0"
    "00",
    8};
constexpr std::size_t end_bytes = 2 * tar_block_bytes;  ///< two blocks of zeros
constexpr std::string_view blobs_folder = "blobs/";
constexpr std::string_view manifest_name = "manifest.sqlite";
constexpr const char* not_a_backup = "this is no backup that `raynest backup` has made: ";

using Head = std::array<std::byte, tar_block_bytes>;

void put(Head& head, Field field, std::string_view text) {
    std::memcpy(head.data() + field.at, text.data(), std::min(field.bytes, text.size()));
}

void put_octal(Head& head, Field field, std::uint64_t value) {
    put(head, field, fmt::format("{:0{}o}", value, field.bytes - 1));
}

/// Sizes from 8 GiB on have no octal digits enough; GNU tar writes them as numbers.
void put_size(Head& head, std::uint64_t size) {
    constexpr std::uint64_t octal_most = (1ULL << 33) - 1;
    if (size <= octal_most) return put_octal(head, size_field, size);
    for (std::size_t i = 0; i < sizeof size; ++i)
        head[size_field.at + size_field.bytes - 1 - i] = std::byte(size >> (8 * i));
    head[size_field.at] = base_256;
}

/// The sum of all bytes, with spaces in place of the sum.
std::uint64_t sum_of(std::span<const std::byte> head) {
    std::uint64_t sum = sum_field.bytes * std::uint64_t{' '};
    for (std::size_t i = 0; i < head.size(); ++i)
        if (i < sum_field.at || i >= sum_field.at + sum_field.bytes)
            sum += std::to_integer<std::uint64_t>(head[i]);
    return sum;
}

Head head_of(const std::string& name, std::uint64_t bytes) {
    Head head{};
    put(head, name_field, name);
    put_octal(head, mode_field, 0600);
    put_octal(head, owner_field, 0);
    put_octal(head, group_field, 0);
    put_size(head, bytes);
    put_octal(head, time_field, static_cast<std::uint64_t>(std::time(nullptr)));
    head[type_at] = std::byte{'0'};
    put(head, magic_field, magic);
    put(head, sum_field, fmt::format("{:06o}", sum_of(head)) + std::string("\0 ", 2));
    return head;
}

std::string_view text_of(std::span<const std::byte> head, Field field) {
    const std::string_view text(reinterpret_cast<const char*>(head.data()) + field.at, field.bytes);
    return text.substr(0, std::min(text.find('\0'), text.size()));
}

std::optional<std::uint64_t> octal_of(std::span<const std::byte> head, Field field) {
    std::uint64_t value = 0;
    bool is_empty = true;
    for (const char c : text_of(head, field)) {
        if (c == ' ') continue;
        if (c < '0' || c > '7') return std::nullopt;
        value = value * 8 + static_cast<std::uint64_t>(c - '0');
        is_empty = false;
    }
    if (is_empty) return std::nullopt;
    return value;
}

std::optional<std::uint64_t> size_of(std::span<const std::byte> head) {
    if ((head[size_field.at] & base_256) == std::byte{0}) return octal_of(head, size_field);
    std::uint64_t value = 0;
    for (std::size_t i = 1; i < size_field.bytes; ++i) {
        if (value >> 56 != 0) return std::nullopt;
        value = value << 8 | std::to_integer<std::uint64_t>(head[size_field.at + i]);
    }
    return value;
}

std::size_t padding_of(std::uint64_t bytes) {
    return static_cast<std::size_t>((tar_block_bytes - bytes % tar_block_bytes) % tar_block_bytes);
}

tl::unexpected<Error> disk_refuses(int error) {
    const bool full = error == ENOSPC || error == EDQUOT || error == EFBIG;
    return fail(ErrorCode::io_failed,
                full ? std::string("the state folder has no room for the backup; make room on its "
                                   "disk")
                     : "the backup could not be written to the state folder: " + reason(error) +
                           "; see to its disk");
}

}  // namespace

void ArchiveSource::add(const std::string& name, std::filesystem::path file, std::uint64_t bytes) {
    parts_.push_back({std::move(file), bytes, end_, head_of("raynest-state/" + name, bytes)});
    end_ += tar_block_bytes + bytes + padding_of(bytes);
}

std::uint64_t ArchiveSource::bytes() const {
    return end_ + end_bytes;
}

Result<void> ArchiveSource::read(std::uint64_t offset, std::span<std::byte> into) {
    while (!into.empty()) {
        if (offset >= end_) {
            std::ranges::fill(into, std::byte{0});
            return {};
        }
        const auto after = std::ranges::upper_bound(parts_, offset, {}, &Part::first);
        const auto index = static_cast<std::size_t>(after - parts_.begin()) - 1;
        const Part& part = parts_[index];
        const std::uint64_t at = offset - part.first;
        std::size_t count = 0;
        if (at < tar_block_bytes) {
            count = std::min<std::size_t>(into.size(), tar_block_bytes - at);
            std::memcpy(into.data(), part.head.data() + at, count);
        } else if (at - tar_block_bytes >= part.bytes) {
            count = static_cast<std::size_t>(std::min<std::uint64_t>(
                into.size(), tar_block_bytes + part.bytes + padding_of(part.bytes) - at));
            std::fill_n(into.begin(), count, std::byte{0});
        } else {
            if (!open_ || open_part_ != index) open_ = std::make_unique<File>(part.file, O_RDONLY);
            open_part_ = index;
            const std::uint64_t in_file = at - tar_block_bytes;
            const std::size_t most = std::min<std::uint64_t>(into.size(), part.bytes - in_file);
            const ssize_t done = open_->is_open() ? ::pread(open_->number(), into.data(), most,
                                                            static_cast<off_t>(in_file))
                                                  : -1;
            if (done < 0 && errno == EINTR) continue;
            if (done <= 0)
                return fail(ErrorCode::io_failed, "cannot read " + part.file.filename().string() +
                                                      " of the state folder: " +
                                                      (done == 0 ? "it was cut" : reason(errno)) +
                                                      "; raynestd check says which scene this is");
            count = static_cast<std::size_t>(done);
        }
        offset += count;
        into = into.subspan(count);
    }
    return {};
}

ArchiveTarget::~ArchiveTarget() {
    if (!manifest_.empty()) state_.discard(std::move(manifest_));
    for (auto& [digest, blob] : blobs_) state_.discard(std::move(blob.file));
}

Result<void> ArchiveTarget::begin(std::span<const std::byte> head) {
    const auto refused = [](const std::string& why) {
        return fail(ErrorCode::scene_invalid, not_a_backup + why);
    };
    if (std::ranges::all_of(head, [](std::byte byte) { return byte == std::byte{0}; })) {
        ended_ = true;
        return {};
    }
    const auto sum = octal_of(head, sum_field);
    const auto size = size_of(head);
    if (!sum || *sum != sum_of(head) || !size) return refused("it is no tar file, or is damaged");
    left_ = *size;
    padding_ = padding_of(left_);
    file_ = nullptr;
    const char type = std::to_integer<char>(head[type_at]);
    // Folders, and what newer tars say of the file that follows.
    if (type == '5' || type == 'x' || type == 'g') return {};
    const std::string_view path = text_of(head, name_field);
    const std::string_view name = path.substr(path.rfind('/') + 1);
    const bool is_blob =
        is_digest(name) && path.substr(0, path.size() - name.size()).ends_with(blobs_folder);
    const bool is_manifest = name == manifest_name;
    if ((type != '0' && type != '\0') || (!is_blob && !is_manifest))
        return refused("it holds what no backup has");
    if (is_blob && wanted_ && !wanted_->contains(std::string(name))) return {};
    if (is_blob) blob_ = name;
    Blob* const blob = is_blob ? &blobs_[blob_] : nullptr;
    std::filesystem::path& place = is_blob ? blob->file : manifest_;
    if (!place.empty()) return refused("it holds a file twice");
    if (is_blob) blob->bytes = left_;
    place = state_.new_path();
    file_ = std::make_unique<File>(place, O_WRONLY | O_CREAT | O_EXCL, S_IRUSR | S_IWUSR);
    if (!file_->is_open()) return disk_refuses(errno);
    return {};
}

Result<void> ArchiveTarget::hash_piece() {
    Sha256 digest{};
    if (!hash_bytes(std::exchange(piece_, {}), digest)) return no_sha256();
    digests_.insert(digests_.end(), digest.begin(), digest.end());
    return {};
}

Result<void> ArchiveTarget::end_file() {
    if (file_ == nullptr) return {};
    if (::fsync(file_->number()) != 0) return state_.flush_failed(errno);
    file_ = nullptr;
    const std::string blob = std::exchange(blob_, {});
    has_manifest_ = has_manifest_ || blob.empty();
    if (blob.empty()) return {};
    if (!piece_.empty())
        if (auto hashed = hash_piece(); !hashed) return hashed;
    Sha256 whole{};
    if (!hash_bytes(std::as_bytes(std::span(digests_)), whole)) return no_sha256();
    digests_.clear();
    if (digest_text(whole) == blob) return {};
    ::unlink(blobs_.at(blob).file.c_str());
    blobs_.erase(blob);
    return {};
}

Result<void> ArchiveTarget::take(std::span<const std::byte> bytes) {
    while (!bytes.empty() && !ended_) {
        if (left_ != 0) {
            const auto count =
                static_cast<std::size_t>(std::min<std::uint64_t>(left_, bytes.size()));
            for (std::size_t at = 0; file_ && at < count;) {
                const ssize_t done = ::write(file_->number(), bytes.data() + at, count - at);
                if (done < 0 && errno == EINTR) continue;
                if (done < 0) return disk_refuses(errno);
                at += static_cast<std::size_t>(done);
            }
            left_ -= count;
            for (auto rest = bytes.first(count); !blob_.empty() && !rest.empty();) {
                const std::size_t more = std::min(digest_piece_bytes - piece_.size(), rest.size());
                piece_.insert(piece_.end(), rest.begin(),
                              rest.begin() + static_cast<std::ptrdiff_t>(more));
                rest = rest.subspan(more);
                if (piece_.size() == digest_piece_bytes)
                    if (auto hashed = hash_piece(); !hashed) return hashed;
            }
            bytes = bytes.subspan(count);
            if (left_ != 0) continue;
        }
        if (auto ended = end_file(); !ended) return ended;
        const std::size_t skipped = std::min(padding_, bytes.size());
        padding_ -= skipped;
        bytes = bytes.subspan(skipped);
        const std::size_t count = std::min(tar_block_bytes - head_.size(), bytes.size());
        head_.insert(head_.end(), bytes.begin(),
                     bytes.begin() + static_cast<std::ptrdiff_t>(count));
        bytes = bytes.subspan(count);
        if (head_.size() < tar_block_bytes) continue;
        if (auto begun = begin(std::exchange(head_, {})); !begun) return begun;
    }
    return {};
}

Result<void> ArchiveTarget::finish() {
    if (!ended_)
        return fail(ErrorCode::scene_invalid, std::string(not_a_backup) + "it was cut off");
    if (manifest_.empty())
        return fail(ErrorCode::scene_invalid,
                    std::string(not_a_backup) + "its manifest is missing");
    return {};
}

}  // namespace raynest::server
