#include "server/store/manifest.h"

#include "engine/system/child_process.h"
#include "protocol/hash.h"
#include "protocol/subject.h"
#include "protocol/validate.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sqlite3.h>
#include <sys/stat.h>
#include <unistd.h>

#include <bit>
#include <cerrno>
#include <cstring>
#include <span>
#include <utility>

namespace raynest::server {
namespace {

/// Tells a manifest from files of other programs: "RNST".
constexpr int application = 0x524E5354;
constexpr const char* remedy =
    "; nothing was changed. Bring a backup back (raynestd restore BACKUP DIR), or name another "
    "--state";

/// Returns the file's name for SQLite. A manifest that was closed well is read without files beside
/// it.
std::string uri_of(const std::filesystem::path& file, bool read_only) {
    std::string uri = "file:";
    for (const char c : std::filesystem::absolute(file).string())
        if (c == '%' || c == '?' || c == '#')
            uri += fmt::format("%{:02x}", c);
        else
            uri += c;
    std::error_code ignored;
    const bool open = std::filesystem::exists(file.string().append("-wal"), ignored);
    return read_only && !open ? uri.append("?immutable=1") : uri;
}

/// Returns the checksum of a row: SQLite finds damaged pages, not changed letters.
std::int64_t checksum(const StoredScene& scene) {
    std::string text =
        fmt::format("{}\n{}\n{}\n{}\n{}\n{}\n{}\n{}\n{}\n{}", scene.number, scene.owner, scene.name,
                    scene.share.text(), scene.digest, scene.epoch, scene.bytes,
                    scene.instanced_triangles, scene.build_seconds, scene.used);
    if (!scene.content.empty()) text.append("\n").append(scene.content);
    return std::bit_cast<std::int64_t>(protocol::upload_checksum(std::as_bytes(std::span(text))));
}

std::int64_t checksum(const KeptEdit& edit) {
    const std::string text =
        fmt::format("{}\n{}\n{}\n{}\n{}\n{}\n", edit.number, edit.epoch, edit.before, edit.digest,
                    edit.bytes, edit.instanced_triangles);
    return std::bit_cast<std::int64_t>(protocol::upload_checksum(
        edit.change, protocol::upload_checksum(std::as_bytes(std::span(text)))));
}

}  // namespace

std::string gap_in(const std::vector<KeptEdit>& edits, std::uint64_t epoch) {
    for (const KeptEdit& edit : edits) {
        if (edit.before != epoch)
            return fmt::format("its edit of epoch {} follows epoch {}, not {}", edit.epoch,
                               edit.before, epoch);
        epoch = edit.epoch;
    }
    return "";
}

bool is_sound(const StoredScene& scene) {
    constexpr std::uint64_t most = 1ULL << 62;
    constexpr std::int64_t seconds_max = std::int64_t{1} << 40;
    constexpr std::size_t text_max = 4096;
    const auto is_name = [](const std::string& text) {
        return !text.empty() && text.size() <= text_max && protocol::printable(text);
    };
    return scene.number >= 1 && scene.number < most && scene.epoch >= 1 && scene.epoch < most &&
           scene.bytes < most && scene.used >= 0 && scene.used < seconds_max &&
           is_name(scene.owner) && is_name(scene.name) && is_digest(scene.digest) &&
           (scene.content.empty() || is_digest(scene.content));
}

bool is_digest(std::string_view text) {
    constexpr std::size_t digits = 64;
    return text.size() == digits &&
           text.find_first_not_of("0123456789abcdef") == std::string_view::npos;
}

void Manifest::Close::operator()(sqlite3* connection) const noexcept {
    sqlite3_close(connection);
}

/// A prepared statement. Values are bound and read in order.
class Manifest::Statement {
public:
    Statement(const Manifest& manifest, const char* sql) {
        sqlite3_prepare_v2(manifest.connection_.get(), sql, -1, &statement_, nullptr);
    }
    Statement(const Statement&) = delete;
    ~Statement() { sqlite3_finalize(statement_); }
    void bind(const std::string& text) {
        sqlite3_bind_text(statement_, ++bound_, text.data(), static_cast<int>(text.size()),
                          SQLITE_TRANSIENT);
    }
    void bind(const std::vector<std::byte>& bytes) {
        sqlite3_bind_blob64(statement_, ++bound_,
                            bytes.empty() ? "" : static_cast<const void*>(bytes.data()),
                            bytes.size(), SQLITE_STATIC);
    }
    void bind(std::int64_t number) { sqlite3_bind_int64(statement_, ++bound_, number); }
    void bind(std::uint64_t number) { bind(static_cast<std::int64_t>(number)); }
    void bind(double number) { sqlite3_bind_double(statement_, ++bound_, number); }
    int step() { return sqlite3_step(statement_); }
    std::string text() {
        const int column = read_++;
        const auto* bytes = static_cast<const char*>(sqlite3_column_blob(statement_, column));
        const auto size = static_cast<std::size_t>(sqlite3_column_bytes(statement_, column));
        return bytes == nullptr ? std::string() : std::string(bytes, size);
    }
    std::vector<std::byte> bytes() {
        const int column = read_++;
        const auto* first = static_cast<const std::byte*>(sqlite3_column_blob(statement_, column));
        return first == nullptr
                   ? std::vector<std::byte>()
                   : std::vector(first, first + sqlite3_column_bytes(statement_, column));
    }
    std::int64_t integer() { return sqlite3_column_int64(statement_, read_++); }
    std::uint64_t count() { return static_cast<std::uint64_t>(integer()); }
    double real() { return sqlite3_column_double(statement_, read_++); }
    void next_row() { read_ = 0; }

private:
    sqlite3_stmt* statement_ = nullptr;
    int bound_ = 0;
    int read_ = 0;
};

tl::unexpected<Error> Manifest::fault(const std::string& doing) {
    const int code = sqlite3_extended_errcode(connection_.get());
    // After a failed fsync the next one may succeed although the bytes are lost.
    if (code == SQLITE_IOERR_FSYNC || code == SQLITE_IOERR_DIR_FSYNC) failed_ = true;
    return fail(ErrorCode::io_failed, doing + ": " +
                                          (sqlite3_errmsg(connection_.get()) == nullptr
                                               ? "unknown"
                                               : sqlite3_errmsg(connection_.get())));
}

Result<void> Manifest::run(const char* sql) {
    if (sqlite3_exec(connection_.get(), sql, nullptr, nullptr, nullptr) == SQLITE_OK) return {};
    return fault("the manifest of the state folder could not be changed");
}

Result<void> Manifest::check() {
    const auto damaged = [&](const std::string& why) {
        return fail(ErrorCode::io_failed, "the manifest " + file_ + " is damaged: " + why + remedy);
    };
    Statement integrity(*this, "PRAGMA integrity_check(1)");
    if (const int state = integrity.step(); state != SQLITE_ROW) {
        const char* why = sqlite3_errmsg(connection_.get());
        if (const int kind = state & 0xFF; kind == SQLITE_BUSY || kind == SQLITE_LOCKED)
            return fail(ErrorCode::io_failed,
                        "the manifest " + file_ + " is in use (" + why +
                            "); stop the raynestd of an older release that has it open");
        else if (kind == SQLITE_CANTOPEN || kind == SQLITE_READONLY || kind == SQLITE_PERM)
            return fail(ErrorCode::io_failed, "the manifest " + file_ + " cannot be read (" + why +
                                                  "); run this as the daemon's user");
        return damaged(why);
    }
    if (const std::string found = integrity.text(); found != "ok") return damaged(found);
    Statement kind(*this, "PRAGMA application_id");
    Statement version(*this, "PRAGMA user_version");
    Statement tables(*this, "SELECT count(*) FROM sqlite_schema");
    // Views and triggers of others would run when it is read and written.
    Statement foreign(*this,
                      "SELECT name FROM sqlite_schema WHERE NOT (type = 'table' AND name IN "
                      "('scenes', 'edits', 'uses') OR type = 'index' AND sql IS NULL) LIMIT 1");
    if (kind.step() != SQLITE_ROW || version.step() != SQLITE_ROW || tables.step() != SQLITE_ROW)
        return damaged(sqlite3_errmsg(connection_.get()));
    const std::int64_t found = version.integer();
    const std::int64_t of = kind.integer();
    if (tables.integer() == 0 && of == 0 && found == 0) return {};
    if (of != application) return damaged("it is not one of raynestd");
    if (found > manifest_version)
        return fail(
            ErrorCode::io_failed,
            fmt::format("{} has version {}, this raynestd knows {}: a newer one wrote it. Start "
                        "that one, or name another --state",
                        file_, found, manifest_version));
    if (found < 1) return damaged(fmt::format("it has version {}", found));
    if (foreign.step() != SQLITE_DONE)
        return damaged("it has what raynestd has not put there: " + foreign.text());
    // A column that is computed may have any length, and so may one that rows do not have.
    Statement computed(
        *this,
        "SELECT c.name FROM sqlite_schema t, pragma_table_xinfo(t.name) c WHERE "
        "t.type = 'table' AND (c.hidden <> 0 OR ifnull(c.dflt_value, '''''') <> '''''') "
        "LIMIT 1");
    if (computed.step() != SQLITE_DONE)
        return damaged("its column " + computed.text() + " is computed, or has a default");
    has_edits_ = found > 1;
    has_content_ = found > 2;
    return {};
}

Result<Manifest> Manifest::open(const std::filesystem::path& file, bool read_only) {
    std::error_code ignored;
    if (const auto status = std::filesystem::symlink_status(file, ignored);
        std::filesystem::exists(status) && !std::filesystem::is_regular_file(status))
        return fail(ErrorCode::io_failed, "the manifest " + file.string() + " is no regular file");
    if (!read_only && std::filesystem::exists(file, ignored)) {
        // A connection that may write changes a damaged file when it is closed.
        auto look = open(file, true);
        if (!look) return look;
        if (const auto rows = look->rows(); !rows) return tl::unexpected(rows.error());
    }
    // Names, owners and shares are for the daemon's user alone, whatever the folder's mode.
    if (!read_only) {
        constexpr int access = 0600;
        (void)Fd(::open(file.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, access));
        std::filesystem::permissions(file, std::filesystem::perms(access), ignored);
    }
    Manifest manifest;
    manifest.file_ = file.string();
    sqlite3* connection = nullptr;
    const int mode = read_only ? SQLITE_OPEN_READONLY : SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE;
    const int opened = sqlite3_open_v2(uri_of(file, read_only).c_str(), &connection,
                                       mode | SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_URI, nullptr);
    manifest.connection_.reset(connection);
    if (opened != SQLITE_OK) return manifest.fault("cannot open " + file.string());
    sqlite3_extended_result_codes(connection, 1);
    sqlite3_busy_timeout(connection, 2000);
    sqlite3_db_config(connection, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
    sqlite3_db_config(connection, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
    if (const auto good = manifest.check(); !good) return tl::unexpected(good.error());
    if (read_only) return manifest;
    // Others may read it meanwhile (store/backup.h); the folder's lock keeps a second daemon away.
    for (const char* sql :
         {"PRAGMA journal_mode=WAL", "PRAGMA synchronous=FULL", "BEGIN IMMEDIATE",
          "CREATE TABLE IF NOT EXISTS scenes(number INTEGER NOT NULL, owner TEXT NOT NULL, "
          "name TEXT NOT NULL, share TEXT NOT NULL, digest TEXT NOT NULL, epoch INTEGER NOT NULL, "
          "bytes INTEGER NOT NULL, triangles INTEGER NOT NULL, build_seconds REAL NOT NULL, "
          "used INTEGER NOT NULL, checksum INTEGER NOT NULL, content TEXT NOT NULL DEFAULT '', "
          "PRIMARY KEY(owner, name)) STRICT",
          "CREATE TABLE IF NOT EXISTS edits(number INTEGER NOT NULL, epoch INTEGER NOT NULL, "
          "before INTEGER NOT NULL, digest TEXT NOT NULL, bytes INTEGER NOT NULL, "
          "triangles INTEGER NOT NULL, change BLOB NOT NULL, checksum INTEGER NOT NULL, "
          "PRIMARY KEY(number, epoch)) STRICT",
          manifest.has_content_ ? ""
                                : "ALTER TABLE scenes ADD COLUMN content TEXT NOT NULL DEFAULT ''",
          // Not in the version: an older release leaves this table alone.
          "CREATE TABLE IF NOT EXISTS uses(number INTEGER PRIMARY KEY, used INTEGER NOT NULL, "
          "pinned INTEGER NOT NULL) STRICT",
          "PRAGMA application_id=1380864852", "PRAGMA user_version=3", "COMMIT"})
        if (const auto done = manifest.run(sql); !done)
            return fail(ErrorCode::io_failed, file.string() + ": " + done.error().message);
    static_assert(application == 1380864852 && manifest_version == 3);
    manifest.has_edits_ = manifest.has_content_ = true;
    return manifest;
}

Result<void> Manifest::copy_to(const std::filesystem::path& file) {
    // Names, owners and shares are for the daemon's user alone; SQLite takes an empty file.
    const int made =
        ::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, S_IRUSR | S_IWUSR);
    if (made < 0)
        return fail(ErrorCode::io_failed,
                    "cannot make " + file.string() + ": " + std::strerror(errno));
    ::close(made);
    Statement copy(*this, "VACUUM INTO ?");
    copy.bind(file.string());
    if (copy.step() == SQLITE_DONE) return {};
    return fault("cannot copy the manifest to " + file.string());
}

Result<std::vector<StoredScene>> Manifest::rows() {
    Statement all(*this, has_content_
                             ? "SELECT number, owner, name, share, digest, epoch, bytes, "
                               "triangles, build_seconds, used, checksum, content FROM scenes "
                               "ORDER BY number"
                             : "SELECT number, owner, name, share, digest, epoch, bytes, "
                               "triangles, build_seconds, used, checksum, '' FROM scenes "
                               "ORDER BY number");
    std::vector<StoredScene> rows;
    int state = SQLITE_DONE;
    while ((state = all.step()) == SQLITE_ROW) {
        StoredScene& scene = rows.emplace_back();
        all.next_row();
        scene.number = all.count();
        scene.owner = all.text();
        scene.name = all.text();
        const std::string share = all.text();
        scene.digest = all.text();
        scene.epoch = all.count();
        scene.bytes = all.count();
        scene.instanced_triangles = all.count();
        scene.build_seconds = all.real();
        scene.used = all.integer();
        const std::int64_t sum = all.integer();
        scene.content = all.text();
        const auto principals = protocol::split_principals(share);
        if (!share.empty() && principals) scene.share = *principals;
        if (!is_sound(scene) || sum != checksum(scene))
            return fail(ErrorCode::io_failed,
                        fmt::format("the manifest {} is damaged: row {} is not as it was written{}",
                                    file_, scene.number, remedy));
    }
    if (state != SQLITE_DONE)
        return fail(ErrorCode::io_failed, "the manifest " + file_ + " is damaged: " +
                                              sqlite3_errmsg(connection_.get()) + remedy);
    return rows;
}

Result<void> Manifest::put(const StoredScene& scene) {
    Statement row(*this, "INSERT OR REPLACE INTO scenes VALUES(?,?,?,?,?,?,?,?,?,?,?,?)");
    row.bind(scene.number);
    row.bind(scene.owner);
    row.bind(scene.name);
    row.bind(scene.share.text());
    row.bind(scene.digest);
    row.bind(scene.epoch);
    row.bind(scene.bytes);
    row.bind(scene.instanced_triangles);
    row.bind(scene.build_seconds);
    row.bind(scene.used);
    row.bind(checksum(scene));
    row.bind(scene.content);
    if (row.step() == SQLITE_DONE) return {};
    return fault("the scene could not be entered in the state folder");
}

Result<void> Manifest::remove(const std::string& owner, const std::string& name,
                              std::uint64_t number) {
    Statement row(*this, "DELETE FROM scenes WHERE owner=? AND name=? AND number<=?");
    row.bind(owner);
    row.bind(name);
    row.bind(number);
    if (row.step() == SQLITE_DONE) return {};
    return fault("the scene could not be removed from the state folder");
}

Result<void> Manifest::together(const std::function<Result<void>()>& changes) {
    Result<void> done = run("BEGIN IMMEDIATE");
    if (!done) return done;
    done = changes();
    if (done) done = run("COMMIT");
    if (!done) sqlite3_exec(connection_.get(), "ROLLBACK", nullptr, nullptr, nullptr);
    return done;
}

Result<void> Manifest::put(const KeptEdit& edit) {
    Statement row(*this, "INSERT OR REPLACE INTO edits VALUES(?,?,?,?,?,?,?,?)");
    row.bind(edit.number);
    row.bind(edit.epoch);
    row.bind(edit.before);
    row.bind(edit.digest);
    row.bind(edit.bytes);
    row.bind(edit.instanced_triangles);
    row.bind(edit.change);
    row.bind(checksum(edit));
    if (row.step() == SQLITE_DONE) return {};
    return fault("the edit could not be entered in the state folder");
}

Result<void> Manifest::remove_edits(std::uint64_t number) {
    Statement rows(*this, "DELETE FROM edits WHERE number=?");
    rows.bind(number);
    if (rows.step() == SQLITE_DONE) return {};
    return fault("edits could not be removed from the state folder");
}

Result<void> Manifest::remove_orphans() {
    if (auto done = run("DELETE FROM edits WHERE number NOT IN (SELECT number FROM scenes)"); !done)
        return done;
    return run("DELETE FROM uses WHERE number NOT IN (SELECT number FROM scenes)");
}

Result<std::vector<KeptEdit>> Manifest::edits(std::uint64_t number) {
    std::vector<KeptEdit> edits;
    if (!has_edits_) return edits;
    Statement rows(*this,
                   "SELECT epoch, before, digest, bytes, triangles, change, checksum FROM edits "
                   "WHERE number=? AND length(change)>0 ORDER BY epoch");
    rows.bind(number);
    int state = SQLITE_DONE;
    while ((state = rows.step()) == SQLITE_ROW) {
        KeptEdit& edit = edits.emplace_back();
        rows.next_row();
        edit.number = number;
        edit.epoch = rows.count();
        edit.before = rows.count();
        edit.digest = rows.text();
        edit.bytes = rows.count();
        edit.instanced_triangles = rows.count();
        edit.change = rows.bytes();
        if (rows.integer() != checksum(edit))
            return fail(ErrorCode::scene_invalid,
                        fmt::format("its edit of epoch {} is not as it was written", edit.epoch));
    }
    if (state == SQLITE_DONE) return edits;
    return fault("the edits in the state folder could not be read");
}

Result<void> Manifest::put(const std::vector<SceneUse>& uses) {
    return together([&]() -> Result<void> {
        for (const SceneUse& use : uses) {
            Statement row(*this, "INSERT OR REPLACE INTO uses VALUES(?,?,?)");
            row.bind(use.number);
            row.bind(use.used_ms);
            row.bind(std::int64_t{use.pinned});
            if (row.step() != SQLITE_DONE)
                return fault("the use of a scene could not be entered in the state folder");
        }
        return {};
    });
}

Result<std::vector<SceneUse>> Manifest::uses() {
    std::vector<SceneUse> uses;
    Statement rows(*this, "SELECT number, used, pinned FROM uses");
    int state = SQLITE_DONE;
    while ((state = rows.step()) == SQLITE_ROW) {
        rows.next_row();
        SceneUse& use = uses.emplace_back();
        use.number = rows.count();
        use.used_ms = rows.integer();
        use.pinned = rows.integer() != 0;
    }
    if (state == SQLITE_DONE) return uses;
    return fault("the uses of scenes in the state folder could not be read");
}

Result<KeptEdits> Manifest::sum_of_edits(std::uint64_t number) {
    KeptEdits sum;
    if (!has_edits_) return sum;
    Statement rows(
        *this,
        "SELECT epoch, before, digest, bytes, triangles, length(change), checksum FROM edits "
        "WHERE number=? ORDER BY epoch");
    rows.bind(number);
    int state = SQLITE_DONE;
    while ((state = rows.step()) == SQLITE_ROW) {
        rows.next_row();
        KeptEdit edit{.number = number, .epoch = rows.count()};
        edit.before = rows.count();
        edit.digest = rows.text();
        edit.bytes = rows.count();
        edit.instanced_triangles = rows.count();
        const std::uint64_t bytes = rows.count();
        // edits() checks those that have a change.
        if (bytes == 0 && rows.integer() != checksum(edit))
            return fail(ErrorCode::io_failed,
                        fmt::format("the manifest {} is damaged: epoch {} of scene {} is not as it "
                                    "was written{}",
                                    file_, edit.epoch, number, remedy));
        sum.epoch_last = edit.epoch;
        if (bytes == 0) continue;
        ++sum.count;
        sum.bytes += bytes;
        sum.last = std::move(edit);
    }
    if (state == SQLITE_DONE) return sum;
    return fault("the edits in the state folder could not be read");
}

}  // namespace raynest::server
