defmodule Situ.Media.WavFile do
  @moduledoc """
  A source that reads a WAV file in buffers, without an external program.

      p |> Situ.Media.WavFile.open("talk.wav") |> Situ.each(&IO.inspect/1)

  The originating time of a buffer is the time of its end, exact to the sample. `Situ.Media.Wav` lists the supported
  kinds of WAV; `start_time:` sets how media time becomes originating time.
  """

  alias Situ.Graph.Placement
  alias Situ.Media.FileTime
  alias Situ.Media.Wav.Reader

  @schema [
    path: [type: :string, required: true, doc: "Path of the file."],
    buffer: [type: :pos_integer, default: 20_000_000, doc: "Length of an audio buffer, ns."],
    start: [type: :non_neg_integer, default: 0, doc: "Media time to begin at, ns."],
    end: [type: {:optional, :pos_integer}, default: nil, doc: "Media time to end at, ns."],
    start_time: FileTime.start_time_option(),
    on_damage: [
      type: {:in, [:error, :warn]},
      default: :error,
      doc: "At the end of a truncated file: fail, or log a warning and complete."
    ]
  ]

  use Situ.Component, outputs: [out: Situ.AudioBuffer], options: @schema

  require Logger

  # Maximum number of buffers emitted per demand.
  @batch 16

  @doc "Adds the source and returns its stream. Raises `Situ.Error` if the file cannot be read."
  @spec open(Situ.Pipeline.t(), Path.t(), keyword()) :: Situ.Stream.t()
  def open(p, path, opts \\ []) do
    {opts, placed} = Placement.split_options!([path: path] ++ opts, @schema, :component)
    {recorded_at, duration} = read_header!(path)
    stream = Situ.source(p, __MODULE__, opts ++ placed)

    FileTime.propose_replay(
      p,
      opts[:start_time],
      recorded_at,
      {opts[:start], opts[:end] || duration}
    )

    stream
  end

  @impl true
  def init(opts), do: {:ok, %{opts: opts, reader: nil, offset: 0, last: 0, damage: nil}}

  @impl true
  def handle_start(context, %{opts: opts} = state) do
    {recorded_at, _duration} = read_header!(opts[:path])
    offset = FileTime.time_offset(opts[:start_time], recorded_at, opts[:start], context)
    {from, to} = FileTime.read_span(offset, {opts[:start], opts[:end]}, context)
    state = %{state | offset: offset, last: offset + from}

    if to && to <= from do
      {[{:complete, state.last}], state}
    else
      case Reader.open(opts[:path], buffer: opts[:buffer], start: from, end: to) do
        {:ok, reader} -> {[], %{state | reader: reader}}
        {:error, error} -> raise error
      end
    end
  end

  @impl true
  def handle_demand(_n, _context, %{reader: nil} = state), do: {[], state}
  def handle_demand(n, _context, state), do: read_buffers(min(n, @batch), [], state)

  # All data has been delivered by now; raising the error earlier would have dropped some of it.
  @impl true
  def handle_stop(_final_time, _context, %{damage: nil} = state), do: {[], close_reader(state)}
  def handle_stop(_final_time, _context, %{damage: error}), do: raise(error)

  @impl true
  def terminate(_reason, state), do: close_reader(state)

  defp read_buffers(0, actions, state), do: {Enum.reverse(actions), state}

  defp read_buffers(n, actions, state) do
    case Reader.next_buffer(state.reader) do
      {:ok, time, buffer, reader} ->
        time = time + state.offset

        read_buffers(n - 1, [{:out, time, buffer} | actions], %{
          state
          | reader: reader,
            last: time
        })

      :eof ->
        {Enum.reverse([{:complete, state.last} | actions]), close_reader(state)}

      {:error, error} ->
        {Enum.reverse([{:complete, state.last} | actions]),
         error |> handle_damage(state) |> close_reader()}
    end
  end

  defp handle_damage(error, %{opts: opts} = state) do
    if opts[:on_damage] == :error do
      %{state | damage: error}
    else
      Logger.warning(Exception.message(error))
      state
    end
  end

  defp close_reader(%{reader: nil} = state), do: state

  defp close_reader(state) do
    Reader.close_file(state.reader)
    %{state | reader: nil}
  end

  defp read_header!(path) do
    case Reader.open(path) do
      {:ok, reader} ->
        Reader.close_file(reader)
        {reader.recorded_at, Reader.total_duration(reader)}

      {:error, error} ->
        raise error
    end
  end
end
