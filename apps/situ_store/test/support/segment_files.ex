defmodule Situ.Test.SegmentFiles do
  @moduledoc "Creates recordings in segments for the tests of all apps."
  alias Situ.Message
  alias Situ.Store.Writer

  @doc """
  Adds a closed segment to recording `name` in `root` and returns its folder. `streams` maps names of streams to times
  in ns, which are also the data. With `open?: true`, returns the writer, still open.
  """
  def write_segment(root, name, streams, opts \\ []) do
    {:ok, writer} = Writer.create(name, root, first_extent: 65_536)
    run = Keyword.get(opts, :run, "one")
    {:ok, _} = Writer.append_catalog(writer, %{kind: "piece", every: 1_000, run: run})

    for {stream, times} <- streams do
      {:ok, written} = Writer.stream(writer, stream, type: :integer)
      {:ok, _} = Writer.append(written, Enum.map(times, &message/1))
    end

    if opts[:open?] do
      writer
    else
      :ok = Writer.close(writer)
      writer.path
    end
  end

  defp message(time),
    do: %Message{data: time, originating_time: time, creation_time: time, sequence_id: time}
end
