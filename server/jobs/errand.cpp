#include "server/jobs/errand.h"

#include <chrono>
#include <new>
#include <string>
#include <thread>

namespace raynest::server {

protocol::Error deadline_error() {
    return {Code::deadline,
            "the request's deadline passed; " +
                std::string(protocol::error_info(Code::deadline).remedy),
            0};
}

void post_surely(const Post& post, const std::function<void()>& done) noexcept {
    constexpr std::chrono::milliseconds pause{10};
    for (;;) {
        try {
            return post(done);
        } catch (const std::bad_alloc&) {
            std::this_thread::sleep_for(pause);
        }
    }
}

}  // namespace raynest::server
