defmodule Situ.Store.SegmentedRecording.Visible do
  @moduledoc false
  # A segment without the messages that a later run hides: `{reader, until}`.
  @behaviour Situ.Recording
  alias Situ.Store.NativeFormat

  @impl true
  def info({reader, _until}), do: NativeFormat.info(reader)
  @impl true
  def streams({reader, _until}), do: NativeFormat.streams(reader)
  @impl true
  def seek({reader, _until}, info, time), do: NativeFormat.seek(reader, info, time)

  @impl true
  def read({reader, until}, info, ordinal, to, limit, opts) do
    to = if to == :unbounded, do: until - 1, else: min(to, until - 1)
    NativeFormat.read(reader, info, ordinal, to, limit, opts)
  end
end
