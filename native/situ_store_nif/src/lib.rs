//! BEAM glue for situ_store: decode, call, encode. It contains no algorithms.

mod columns;
mod drafts;
mod errors;
mod health;
mod inputs;
mod locking;
mod messages;
mod parts;
mod paths;
mod reading;
mod residency;
mod rows;
mod sharing;
mod terms;
mod tracks;
mod transferring;
mod writing;

mod atoms {
    rustler::atoms! {
        ok,
        error,
        nil,
        r#true = "true",
        r#false = "false",
        data,
        originating_time,
        creation_time,
        sequence_id,
        struct_key = "__struct__",
        none,
        lz4,
        zstd,
        each,
        situ_store,
        slow,
        refused,
        stale,
        published,
        ended,
        io,
        locked,
        held,
        exists,
        unsupported,
        no_store,
        not_a_store,
        newer_version,
        not_increasing,
        too_large,
        not_storable,
        not_written,
        unknown_stream,
        deleted,
        closed,
        damaged,
        missing_extent,
        absent,
        crash,
        unknown,
        undecodable,
        stream_exists,
        numbers,
        others,
        integer,
        integers,
        float,
        string,
        boolean,
        changes,
        states,
        other = "$other"
    }
}

rustler::init!("Elixir.Situ.Store.Native");
