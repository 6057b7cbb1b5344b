defmodule Situ.Store.Native do
  @moduledoc false
  # The functions of native/situ_store_nif. Call them only from `Situ.Store.Writer`, `Situ.Store.NativeFormat` and a
  # few low-level modules.

  @on_load :load

  def load do
    path = :filename.join([:code.priv_dir(:situ_store), "native", "situ_store_nif"])
    :erlang.load_nif(path, 0)
  end

  @doc "Reads cached chunks on the current scheduler, and slow chunks or chunks on disk on a dirty scheduler."
  def read(ref, id, ordinal, to, limit, bytes) do
    with :slow <- reader_read_quick(ref, id, ordinal, to, limit, bytes),
         do: reader_read(ref, id, ordinal, to, limit, bytes)
  end

  # Below this size, calling a dirty scheduler would take longer than the work.
  @quick_term 4_096

  @doc "Decodes a term from external format; small ones on the current scheduler."
  def decode_term(bytes) when byte_size(bytes) <= @quick_term, do: term_decode_quick(bytes)
  def decode_term(bytes), do: term_decode(bytes)

  @doc "Checks that bytes in external format are plain data; small ones on the current scheduler."
  def check_term(bytes) when byte_size(bytes) <= @quick_term, do: term_check_quick(bytes)
  def check_term(bytes), do: term_check(bytes)

  def writer_create(_path, _first_extent, _max_extent, _durability, _mode), do: missing()
  def writer_stream(_writer, _name, _compression, _large), do: missing()
  def writer_record(_writer, _record, _now), do: missing()
  def writer_draft(_writer, _stream), do: missing()
  def writer_append(_writer, _stream, _batches), do: missing()
  def writer_append_runs(_writer, _stream, _runs), do: missing()
  def writer_bytes(_writer), do: missing()
  def writer_sync(_writer), do: missing()
  def writer_close(_writer), do: missing()
  def draft_add(_draft, _messages), do: missing()
  def draft_add_columns(_draft, _kind, _columns, _creation_times, _first_id), do: missing()
  def draft_waiting(_draft), do: missing()
  def draft_commit(_writer, _draft, _all), do: missing()
  def reader_open(_path, _verify_large, _max_unpacked), do: missing()
  def reader_state(_reader), do: missing()
  def reader_refresh(_reader), do: missing()
  def reader_refresh_all(_reader), do: missing()
  def reader_count(_reader, _stream), do: missing()
  def reader_shelved(_reader, _name), do: missing()
  def reader_shelve(_reader, _records, _terms), do: missing()
  def reader_statistics(_reader, _stream), do: missing()
  def reader_seek(_reader, _stream, _time), do: missing()
  def reader_seek_quick(_reader, _stream, _time), do: missing()
  def reader_gaps(_reader, _stream, _least), do: missing()
  def reader_read(_reader, _stream, _ordinal, _to, _most, _bytes), do: missing()
  def reader_read_quick(_reader, _stream, _ordinal, _to, _most, _bytes), do: missing()
  def reader_columns(_reader, _stream, _ordinal, _to, _bytes), do: missing()
  def reader_skip(_reader, _stream, _ordinal), do: missing()
  def reader_summary(_reader, _stream, _from, _to, _level), do: missing()
  def reader_tracks(_reader, _stream, _from, _to, _level, _most), do: missing()
  def term_decode(_bytes), do: missing()
  def term_decode_quick(_bytes), do: missing()
  def term_check(_bytes), do: missing()
  def term_check_quick(_bytes), do: missing()
  def summary_level(_from, _to, _pixels), do: missing()
  def reader_damage(_reader), do: missing()
  def reader_extents(_reader), do: missing()
  def reader_verify(_reader, _from, _n), do: missing()
  def store_transfer(_reader, _stream, _ordinal, _to, _bytes, _writer, _target), do: missing()
  def store_repair(_path, _dry, _pid, _tag), do: missing()
  def csv_rows(_path, _separator, _byte, _line, _most, _bytes), do: missing()
  def file_lock(_path, _holder), do: missing()
  def file_lock_give(_lock, _pid), do: missing()
  def file_unlock(_lock), do: missing()
  def shared_writer(_path, _limit), do: missing()
  def shared_reader(_path, _limit), do: missing()
  def shared_reserve(_memory, _size), do: missing()
  def shared_write(_memory, _offset, _parts), do: missing()
  def shared_write_quick(_memory, _offset, _parts), do: missing()
  def shared_read(_memory, _slot, _offset, _length), do: missing()
  def shared_copy(_memory, _offset, _length), do: missing()
  def shared_released(_memory), do: missing()
  def rename_new(_from, _to), do: missing()
  def rename_exchange(_one, _other), do: missing()
  def csv_scan(_path, _layout, _start, _parts), do: missing()
  def csv_values(_path, _layout, _start, _column), do: missing()
  def csv_append(_path, _layout, _start, _targets, _writer), do: missing()
  def reader_await(_reader, _known, _pid, _tag), do: missing()

  defp missing, do: :erlang.nif_error(:nif_not_loaded)
end
