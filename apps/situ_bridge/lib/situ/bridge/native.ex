defmodule Situ.Bridge.Native do
  @moduledoc false
  # The functions of native/situ_bridge_nif. They are called only through the modules of this application, such as
  # `Situ.Bridge.Mcap` and `Situ.Bridge.Format`.
  # See docs/adr/0100-bridges-share-one-app.md.

  @on_load :load

  def load do
    path = :filename.join([:code.priv_dir(:situ_bridge), "native", "situ_bridge_nif"])
    :erlang.load_nif(path, 0)
  end

  def unpack(_compression, _bytes, _size), do: missing()
  def pack_lz4(_bytes), do: missing()
  def csv_lines(_kind, _times, _values), do: missing()
  def mcap_open(_path), do: missing()
  def mcap_open_without_index(_path, _why), do: missing()
  def mcap_info(_reader), do: missing()
  def mcap_chunks(_reader), do: missing()
  def mcap_sizes(_reader, _chunk), do: missing()
  def mcap_span(_reader, _channel, _times), do: missing()
  def mcap_seek(_reader, _channel, _times, _time), do: missing()
  def mcap_read(_reader, _query), do: missing()
  def mcap_attachment(_reader, _offset), do: missing()
  def mcap_create(_path, _profile, _compression, _chunk), do: missing()
  def mcap_channel(_writer, _topic, _encoding, _schema, _metadata), do: missing()
  def mcap_write(_writer, _messages), do: missing()
  def mcap_attach(_writer, _name, _media_type, _time, _data), do: missing()
  def mcap_metadata(_writer, _name, _metadata), do: missing()
  def mcap_flush(_writer), do: missing()
  def mcap_finish(_writer), do: missing()
  def mcap_copy_begin(_reader, _path, _packing, _selection), do: missing()
  def mcap_copy_step(_copy), do: missing()

  defp missing, do: :erlang.nif_error(:nif_not_loaded)
end
