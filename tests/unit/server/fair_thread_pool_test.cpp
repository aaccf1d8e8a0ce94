#include "server/scheduling/fair_thread_pool.h"

#include "tests/patience.h"

#include <doctest/doctest.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <ctime>
#include <future>
#include <latch>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Records the order of tasks on one worker, which is held back until all of them wait.
class Notebook {
public:
    Notebook() {
        workers_.submit("bell", Priority::normal, [this] { release_.get_future().wait(); });
    }
    void add(const std::string& principal, Priority priority, const std::string& name) {
        workers_.submit(principal, priority, [this, name] { names_.push_back(name); });
    }
    std::vector<std::string> run() {
        std::promise<void> done;
        workers_.submit("bell", Priority::low, [&] { done.set_value(); });
        for (int i = 0; i < 1000; ++i)  // the last task of "bell"
            workers_.submit("bell", Priority::normal, [] {});
        release_.set_value();
        done.get_future().wait();
        return names_;
    }

private:
    std::promise<void> release_;
    std::vector<std::string> names_;
    FairThreadPool workers_{1};
};

TEST_CASE("tasks of one principal run in the order of their submission") {
    Notebook notebook;
    for (int i = 0; i < 100; ++i) notebook.add("a", Priority::normal, std::to_string(i));
    const std::vector<std::string> names = notebook.run();
    REQUIRE(names.size() == 100);
    for (std::size_t i = 0; i < names.size(); ++i) CHECK(names[i] == std::to_string(i));
}

TEST_CASE("a principal with one job waits for one task of each other, not for a hundred jobs") {
    Notebook notebook;
    for (int i = 0; i < 300; ++i) notebook.add("crowd", Priority::high, "crowd");
    for (int i = 0; i < 300; ++i) notebook.add("herd", Priority::normal, "herd");
    for (int i = 0; i < 3; ++i) notebook.add("single", Priority::low, "single");
    const std::vector<std::string> names = notebook.run();
    std::vector<std::size_t> places;
    for (std::size_t i = 0; i < names.size(); ++i)
        if (names[i] == "single") places.push_back(i);
    // Alone it would have places 0, 1 and 2.
    CHECK(places == std::vector<std::size_t>{2, 5, 8});
}

TEST_CASE("a principal with a long task skips turns while others wait") {
    FairThreadPool workers(0);
    std::string order;
    const auto spin = [&] {
        const auto end =
            std::clock() + 6 * CLOCKS_PER_SEC * FairThreadPool::slice / std::chrono::seconds(1);
        while (std::clock() < end) {
        }
        order += 'H';
    };
    for (int i = 0; i < 2; ++i) workers.submit("heavy", Priority::normal, spin);
    for (int i = 0; i < 9; ++i) workers.submit("light", Priority::normal, [&] { order += 'l'; });
    while (workers.run_one()) {
    }
    // The two would alternate, but the long task cost five turns or more.
    CHECK(order.size() == 11);
    CHECK(order.substr(0, 6) == "Hlllll");
    // Time that delayed nobody is not charged.
    workers.submit("heavy", Priority::normal, spin);
    CHECK(workers.run_one());
    workers.submit("heavy", Priority::normal, spin);
    workers.submit("light", Priority::normal, [&] { order += 'l'; });
    CHECK(workers.run_one());
    CHECK(order.back() == 'H');
}

TEST_CASE("tasks that wait for something else are charged for waiting") {
    FairThreadPool workers(0, FairThreadPool::Time::clock);
    std::string order;
    for (int i = 0; i < 2; ++i)
        workers.submit("heavy", Priority::normal, [&] {
            std::this_thread::sleep_for(6 * FairThreadPool::slice);
            order += 'H';
        });
    for (int i = 0; i < 5; ++i) workers.submit("light", Priority::normal, [&] { order += 'l'; });
    while (workers.run_one()) {
    }
    CHECK(order == "HlllllH");
}

TEST_CASE("priority orders the tasks of one principal, and takes nothing from another") {
    Notebook notebook;
    notebook.add("a", Priority::low, "a low");
    notebook.add("a", Priority::normal, "a normal");
    notebook.add("a", Priority::high, "a high");
    notebook.add("b", Priority::low, "b low");
    CHECK(notebook.run() == std::vector<std::string>{"a high", "b low", "a normal", "a low"});
}

TEST_CASE("without threads each task waits to be run here") {
    FairThreadPool workers(0);
    int ran = 0;
    for (int i = 0; i < 2; ++i) workers.submit("a", Priority::normal, [&ran] { ++ran; });
    CHECK(ran == 0);
    CHECK(workers.run_one());
    CHECK(ran == 1);
    CHECK(workers.run_one());
    CHECK_FALSE(workers.run_one());
    CHECK(ran == 2);
}

TEST_CASE("a waiting task can be changed or dropped, a started one cannot") {
    FairThreadPool workers(0);
    std::string ran;
    const auto add = [&](const std::string& principal, char name) {
        return workers.submit(principal, Priority::normal, [&ran, name] { ran += name; });
    };
    const auto drop = [] { return false; };
    const std::uint64_t a = add("me", 'a');
    const std::uint64_t b = add("me", 'b');
    const std::uint64_t c = add("me", 'c');
    const std::uint64_t d = add("you", 'd');
    bool changed = false;
    CHECK(workers.change("me", a, [&] { return changed = true; }));
    CHECK(changed);
    CHECK(workers.change("me", b, drop));
    CHECK_FALSE(workers.change("me", b, drop));
    CHECK_FALSE(workers.change("me", d, drop));  // another principal's
    CHECK(workers.change("you", d, drop));       // the only task of its account
    CHECK_FALSE(workers.change("nobody", a, drop));
    CHECK(workers.run_one());
    CHECK_FALSE(workers.change("me", a, drop));
    CHECK(workers.run_one());
    CHECK_FALSE(workers.run_one());
    CHECK(ran == "ac");
    CHECK_FALSE(workers.change("me", c, drop));
    add("you", 'e');
    CHECK(workers.run_one());
    CHECK(ran == "ace");
}

TEST_CASE("workers run at the same time") {
    FairThreadPool workers(2);
    std::promise<void> a;
    std::promise<void> b;
    std::promise<void> met;
    // Each waits for the other: with one thread this would never end.
    workers.submit("a", Priority::normal, [&] {
        a.set_value();
        b.get_future().wait();
        met.set_value();
    });
    workers.submit("a", Priority::normal, [&] {
        a.get_future().wait();
        b.set_value();
    });
    CHECK(met.get_future().wait_for(test::patience()) == std::future_status::ready);
}

TEST_CASE("ending waits for running tasks and drops the others") {
    std::atomic<int> ran{0};
    std::promise<void> started;
    std::promise<void> release;
    auto workers = std::make_unique<FairThreadPool>(1);
    workers->submit("a", Priority::normal, [&] {
        started.set_value();
        release.get_future().wait();
        ++ran;
    });
    started.get_future().wait();
    for (int i = 0; i < 10; ++i) workers->submit("a", Priority::normal, [&ran] { ++ran; });
    std::thread ending([&] { workers.reset(); });
    release.set_value();
    ending.join();
    CHECK(ran >= 1);
    CHECK(ran <= 11);
}

/// Tasks that hold their threads until the end of a test.
class Hold {
public:
    Hold(FairThreadPool& workers, const std::string& principal, int count) {
        for (int i = 0; i < count; ++i)
            workers.submit(principal, Priority::normal, [begun = begun_, end = end_] {
                ++*begun;
                end.wait();
            });
    }
    ~Hold() { release_.set_value(); }
    [[nodiscard]] int begun() const { return *begun_; }

private:
    std::promise<void> release_;
    const std::shared_future<void> end_ = release_.get_future();
    const std::shared_ptr<std::atomic<int>> begun_ = std::make_shared<std::atomic<int>>(0);
};

TEST_CASE("while long tasks hold all threads, spare threads run waiting tasks") {
    FairThreadPool workers(2, FairThreadPool::Time::processor, 2);
    const Hold hold(workers, "heavy", 2);
    for (const char* who : {"heavy", "light"}) {
        for (int i = 0; i < 3; ++i) {
            std::promise<void> done;
            workers.submit(who, Priority::normal, [&] { done.set_value(); });
            done.get_future().wait();
        }
    }
    CHECK(hold.begun() == 2);
}

TEST_CASE("a spare thread stays while tasks wait") {
    FairThreadPool workers(1, FairThreadPool::Time::processor, 4);
    const Hold hold(workers, "heavy", 1);
    constexpr int tasks = 40;
    std::atomic<int> threads{0};
    for (int i = 0; i < tasks; ++i) {  // as a job's chunks: one after the other
        std::promise<void> done;
        workers.submit("light", Priority::normal, [&] {
            thread_local bool is_known = false;
            if (!std::exchange(is_known, true)) ++threads;
            done.set_value();
        });
        done.get_future().wait();
    }
    CHECK(threads < tasks);
}

TEST_CASE("there are as many spare threads as held ones") {
    constexpr int threads = 3;
    constexpr int tasks = 30;
    FairThreadPool workers(threads, FairThreadPool::Time::processor, 8);
    const Hold heavy(workers, "heavy", threads);
    while (heavy.begun() < threads) std::this_thread::yield();
    // Repeat until a round takes less than patience: then no task held its thread long enough for a
    // further spare thread to start, however busy the machine is.
    const auto end = std::chrono::steady_clock::now() + test::patience();
    for (;;) {
        std::atomic<int> at_once{0};
        std::atomic<int> most{0};
        std::latch met(threads);  // each of the first tasks waits for the others
        std::latch done(tasks);
        const auto start = std::chrono::steady_clock::now();
        for (int i = 0; i < tasks; ++i) {
            workers.submit("light", Priority::normal, [&, i] {
                const int now = ++at_once;
                for (int seen = most; seen < now && !most.compare_exchange_weak(seen, now);) {
                }
                if (i < threads) met.arrive_and_wait();
                std::this_thread::sleep_for(std::chrono::milliseconds(1));
                --at_once;
                done.count_down();
            });
        }
        done.wait();
        const auto now = std::chrono::steady_clock::now();
        if (now - start < FairThreadPool::patience) {
            CHECK(most == threads);
            break;
        }
        REQUIRE(now < end);
    }
}

TEST_CASE(
    "a principal without a thread waits for two turns of others, not until their tasks count as "
    "long") {
    // On a busy machine a thread may come late: one good round of many is enough.
    const auto end = std::chrono::steady_clock::now() + test::patience();
    for (;;) {
        FairThreadPool workers(2, FairThreadPool::Time::processor, 4);
        const Hold heavy(workers, "heavy", 4);
        while (heavy.begun() < 2) std::this_thread::yield();
        std::promise<std::pair<std::chrono::nanoseconds, int>> seen;
        workers.submit("light", Priority::normal, [&] {
            seen.set_value({workers.longest_task(), heavy.begun()});
        });
        const auto [held, begun] = seen.get_future().get();
        if (held < FairThreadPool::patience) {
            CHECK(begun == 2);  // the thread was for the one who had none
            break;
        }
        REQUIRE(std::chrono::steady_clock::now() < end);
    }
}

TEST_CASE("one principal may use at most half of the spare threads") {
    FairThreadPool workers(1, FairThreadPool::Time::processor, 4);
    const Hold heavy(workers, "heavy", 10);
    while (heavy.begun() < 3) std::this_thread::yield();
    std::promise<void> done;
    workers.submit("light", Priority::low, [&] { done.set_value(); });
    done.get_future().wait();
    const Hold light(workers, "light", 10);
    while (light.begun() < 2) std::this_thread::yield();
    std::this_thread::sleep_for(3 * FairThreadPool::patience);
    CHECK(heavy.begun() == 3);  // the thread and half of the spare ones
    CHECK(light.begun() == 2);
}

TEST_CASE("the longest running task is told, and none once it has ended") {
    FairThreadPool workers(2);
    CHECK(workers.longest_task() == std::chrono::nanoseconds(0));
    {
        const Hold stuck(workers, "stuck", 1);
        while (stuck.begun() < 1) std::this_thread::yield();
        CHECK(test::eventually(
            [&] { return workers.longest_task() >= std::chrono::milliseconds(50); }));
    }
    CHECK(test::eventually([&] { return workers.longest_task() == std::chrono::nanoseconds(0); }));
}

TEST_CASE("tasks that last leave places to principals that have none, however many wait") {
    constexpr unsigned threads = 5;
    constexpr unsigned each = 2;
    std::promise<void> release;
    const std::shared_future<void> released = release.get_future().share();
    std::mutex mutex;
    std::condition_variable changed;
    std::map<std::string, int> running;
    FairThreadPool imports(threads, FairThreadPool::Time::clock, 0, each);
    const auto submit = [&](const std::string& principal) {
        imports.submit(principal, Priority::normal, [&, principal] {
            {
                const std::lock_guard lock(mutex);
                ++running[principal];
            }
            changed.notify_all();
            released.wait();
        });
    };
    const auto comes_to_run = [&](const std::string& principal, int count) {
        std::unique_lock lock(mutex);
        return changed.wait_for(lock, test::patience(),
                                [&] { return running[principal] == count; });
    };
    for (const char* greedy : {"a", "b"})
        for (int i = 0; i < 20; ++i) submit(greedy);
    CHECK(comes_to_run("a", 2));
    CHECK(comes_to_run("b", 2));
    submit("single");
    CHECK(comes_to_run("single", 1));
    submit("late");  // all places are taken; it waits for one
    {
        const std::lock_guard lock(mutex);
        CHECK(running["a"] + running["b"] == 4);
        CHECK(running["late"] == 0);
    }
    release.set_value();
    CHECK(comes_to_run("late", 1));
    CHECK(comes_to_run("a", 20));
    CHECK(comes_to_run("b", 20));
}

}  // namespace
}  // namespace raynest::server
