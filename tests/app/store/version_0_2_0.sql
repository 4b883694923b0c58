CREATE TABLE drives (
  id VARCHAR(255) NOT NULL PRIMARY KEY, name VARCHAR(255) NOT NULL, owner VARCHAR(255) NOT NULL, state VARCHAR(255) NOT NULL,
  options JSON NOT NULL, keep_raw BOOLEAN NOT NULL, report JSON,
  file_count BIGINT NOT NULL, size_bytes BIGINT NOT NULL, stored_bytes BIGINT NOT NULL,
  created_at FLOAT NOT NULL, touched_at FLOAT NOT NULL, deleted_at FLOAT, deleted_by VARCHAR(255),
  idempotency_key VARCHAR(255), request_sha256 VARCHAR(64), note TEXT,
  west FLOAT, south FLOAT, east FLOAT, north FLOAT
);
CREATE INDEX ix_drives_state_touched ON drives (state, touched_at);
CREATE UNIQUE INDEX ix_drives_idempotency ON drives (owner, idempotency_key);
CREATE TABLE drive_files (
  drive_id VARCHAR(255) NOT NULL, path VARCHAR(512) NOT NULL,
  size_bytes BIGINT NOT NULL, sha256 VARCHAR(64) NOT NULL, mtime_ns BIGINT, folded VARCHAR(32),
  PRIMARY KEY (drive_id, path), FOREIGN KEY (drive_id) REFERENCES drives (id) ON DELETE CASCADE
);
CREATE INDEX ix_drive_files_folded ON drive_files (drive_id, folded) WHERE folded IS NOT NULL;
CREATE TABLE jobs (
  id VARCHAR(255) NOT NULL PRIMARY KEY, kind VARCHAR(255) NOT NULL,
  drive_id VARCHAR(255) NOT NULL, owner VARCHAR(255) NOT NULL,
  request JSON NOT NULL, name VARCHAR(255), note TEXT, idempotency_key VARCHAR(255),
  state VARCHAR(255) NOT NULL, stage VARCHAR(255) NOT NULL, message TEXT,
  done BIGINT NOT NULL, total BIGINT, version BIGINT NOT NULL, error JSON, summary JSON,
  created_at FLOAT NOT NULL, started_at FLOAT, finished_at FLOAT, deleted_at FLOAT, deleted_by VARCHAR(255),
  attempts INTEGER NOT NULL, lease_owner VARCHAR(255), lease_until FLOAT, cancel_requested BOOLEAN NOT NULL,
  CONSTRAINT uq_jobs_idempotency UNIQUE (owner, idempotency_key),
  FOREIGN KEY (drive_id) REFERENCES drives (id) ON DELETE CASCADE
);
CREATE INDEX ix_jobs_drive ON jobs (drive_id);
CREATE INDEX ix_jobs_state_created ON jobs (state, created_at);
CREATE TABLE tokens (
  name VARCHAR(255) NOT NULL PRIMARY KEY, sha256 VARCHAR(64) NOT NULL, created_at FLOAT NOT NULL,
  scope VARCHAR(255) DEFAULT 'write' NOT NULL, expires_at FLOAT, last_used_at FLOAT, max_bytes BIGINT, max_jobs BIGINT,
  UNIQUE (sha256)
);
CREATE TABLE installation (id VARCHAR(255) NOT NULL PRIMARY KEY, created_at FLOAT NOT NULL);
CREATE TABLE feature_chunks (id INTEGER NOT NULL PRIMARY KEY, job_id VARCHAR(255) NOT NULL REFERENCES jobs (id) ON DELETE CASCADE);
CREATE TABLE feature_columns (
  chunk_id INTEGER NOT NULL REFERENCES feature_chunks (id) ON DELETE CASCADE, name VARCHAR(64) NOT NULL,
  PRIMARY KEY (chunk_id, name)
);
CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL PRIMARY KEY);
INSERT INTO alembic_version (version_num) VALUES ('0006');
INSERT INTO drives
  (id, name, owner, state, options, keep_raw, file_count, size_bytes, stored_bytes, created_at, touched_at)
  VALUES ('d', 'old', 'me', 'ready', '{}', false, 0, 0, 0, 1.5, 2.5);
INSERT INTO jobs
  (id, kind, drive_id, owner, request, name, state, stage, done, version, created_at, attempts, cancel_requested)
  VALUES ('a', 'intersections', 'd', 'me', '{"name": "mine"}', 'mine', 'failed', 'finished', 0, 1, 1.5, 1, false);
INSERT INTO drive_files (drive_id, path, size_bytes, sha256) VALUES ('d', 'A.txt', 1, 'abc');
INSERT INTO tokens (name, sha256, created_at) VALUES ('alice', 'abc', 1.5);
