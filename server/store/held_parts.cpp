#include "server/store/held_parts.h"

#include "engine/assets/formats/part_file.h"

#include <algorithm>
#include <cstring>
#include <unordered_map>
#include <utility>

namespace raynest::server {
namespace {

class Search {
public:
    Search(std::span<const WantedFile> wanted, const std::function<bool(std::uint64_t)>& reserve,
           const Stop& stop)
        : wanted_(wanted),
          reserve_(reserve),
          stop_(stop),
          found_(wanted.size()) {
        constexpr std::uint64_t hashed_share_max = 16;
        for (std::size_t i = 0; i < wanted.size(); ++i) {
            if (wanted[i].digest == nullptr || wanted[i].into.size() < part_bytes_min) continue;
            missing_.emplace(wanted[i].into.size(), i);
            left_ += hashed_share_max * wanted[i].into.size();
        }
    }

    void look_at(const SceneView& view, PartDigests& digests) {
        for (std::uint32_t i = 0; i < view.object_count && !missing_.empty(); ++i) {
            if (stop_.requested()) return;
            const std::vector<PartFile> files = part_files(view, view.objects[i]);
            for (std::size_t form = 0; form < files.size(); ++form) {
                if (!missing_.contains(files[form].bytes())) continue;
                const auto digest = digests.of(i, form, [&] { return hash(files[form]); });
                if (digest) look_at(files[form], *digest);
            }
        }
    }

    [[nodiscard]] std::vector<bool> found() && { return std::move(found_); }

private:
    PartDigests::Digest hash(const PartFile& file) {
        if (file.bytes() > left_) return std::nullopt;
        left_ -= file.bytes();
        protocol::Sha256 sum;
        file.write([&](std::span<const std::byte> piece) {
            sum.add(piece);
            return !stop_.requested();
        });
        return stop_.requested() ? std::nullopt : sum.digest();
    }

    void look_at(const PartFile& file, const protocol::Sha256Digest& digest) {
        const auto [first, last] = missing_.equal_range(file.bytes());
        bool is_first = true;
        for (auto at = first; at != last;) {
            if (*wanted_[at->second].digest != digest) {
                ++at;
                continue;
            }
            if (std::exchange(is_first, false) && reserve_(file.bytes())) fill_in(file, at->second);
            at = missing_.erase(at);
        }
    }

    void fill_in(const PartFile& file, std::size_t index) {
        std::byte* to = wanted_[index].into.data();
        file.write([&](std::span<const std::byte> piece) {
            std::ranges::copy(piece, to);
            to += piece.size();
            return !stop_.requested();
        });
        found_[index] = !stop_.requested();
    }

    const std::span<const WantedFile> wanted_;
    const std::function<bool(std::uint64_t)>& reserve_;
    const Stop& stop_;
    std::vector<bool> found_;
    std::unordered_multimap<std::uint64_t, std::size_t> missing_;  ///< by length
    std::uint64_t left_ = 0;  ///< bytes that may still be hashed
};

}  // namespace

PartDigests::Digest PartDigests::of(std::uint32_t object, std::size_t form,
                                    const std::function<Digest()>& hash) {
    const std::pair key{object, form};
    {
        const std::lock_guard lock(mutex_);
        if (const auto known = digests_.find(key); known != digests_.end()) return known->second;
    }
    const Digest made = hash();
    const std::lock_guard lock(mutex_);
    if (made) digests_.emplace(key, *made);
    return made;
}

std::vector<bool> fill_in_held_parts(std::span<const std::shared_ptr<const HeldScene>> scenes,
                                     std::span<const WantedFile> wanted,
                                     const std::function<bool(std::uint64_t)>& reserve,
                                     const Stop& stop) {
    Search search(wanted, reserve, stop);
    for (const auto& scene : scenes) search.look_at(scene->snapshot->view(), *scene->part_digests);
    return std::move(search).found();
}

}  // namespace raynest::server
