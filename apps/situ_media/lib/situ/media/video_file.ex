defmodule Situ.Media.VideoFile do
  @moduledoc """
  A source that reads a media file and emits synchronized images on `:video` and audio on `:audio`, with exact times.

      def build(p, _opts) do
        clip = Situ.Media.VideoFile.open(p, "talk1.mp4", size: {640, 320})
        clip.video |> Situ.each(&IO.inspect/1)
        clip.audio |> Situ.each(&IO.inspect/1)
      end

  Supports every file that FFmpeg can read: MP4, AVI, MKV, WebM, MPEG-TS, MP3, FLAC ... If the file has no video or no
  audio, that stream is `nil` in the result of `open/3`. The time of an image is when it is shown, and the time of an
  audio buffer is when it ends; `start_time:` sets how media time becomes originating time. The same file gives the same
  times in every run.

  The source reads on demand, so a slow pipeline makes it wait. A damaged or truncated file emits all readable data,
  and then the run ends with the error `:damaged_media`. With `on_damage: :warn` it completes with a logged warning.
  """

  alias Situ.Graph.Placement
  alias Situ.Media.{Decoder, FileInfo, FileTime}

  @hidden [:loop]
  @schema [
            path: [type: :string, required: true, doc: "Path of the file."],
            start_time: FileTime.start_time_option(),
            on_damage: [
              type: {:in, [:error, :warn]},
              default: :error,
              doc:
                "After the last readable image of a damaged file: fail, or log a warning and complete."
            ],
            info: [
              type: {:optional, {:struct, FileInfo}},
              default: nil,
              doc: "The result of `Situ.Media.FileInfo.read/1`; set by `open/3`."
            ]
          ] ++ Keyword.drop(Decoder.option_schema(), @hidden)

  use Situ.Component,
    outputs: [video: Situ.Image, audio: Situ.AudioBuffer],
    options: @schema

  require Logger

  @doc """
  Adds the source to a pipeline. `opts` are the options of this module and the component options `name:` and
  `on_error:`.

  Returns `%{video: stream | nil, audio: stream | nil}`. Raises `Situ.Error` if the file cannot be read.
  """
  @spec open(Situ.Pipeline.t(), Path.t(), keyword()) :: %{
          video: Situ.Stream.t() | nil,
          audio: Situ.Stream.t() | nil
        }
  def open(p, path, opts \\ []) do
    info = read_info!(path)

    {opts, placed} =
      Placement.split_options!([path: path, info: info] ++ opts, @schema, :component)

    ports = output_ports(info, opts)
    if ports == [], do: raise(no_stream_error(info))
    node = Situ.Pipeline.add(p, __MODULE__, [outputs: ports] ++ opts ++ placed)

    FileTime.propose_replay(
      p,
      opts[:start_time],
      info.recorded_at,
      {opts[:start], opts[:end] || info.duration}
    )

    Map.new([:video, :audio], &{&1, ports[&1] && Situ.Node.output(node, &1)})
  end

  @impl true
  def init(opts) do
    with {:ok, info} <- if(opts[:info], do: {:ok, opts[:info]}, else: FileInfo.read(opts[:path])) do
      {:ok, %{opts: opts, info: info, decoder: nil, offset: 0, last: nil, damage: nil}}
    end
  end

  @impl true
  def handle_start(context, %{opts: opts, info: info} = state) do
    offset = FileTime.time_offset(opts[:start_time], info.recorded_at, opts[:start], context)
    {from, to} = FileTime.read_span(offset, {opts[:start], opts[:end]}, context)
    state = %{state | offset: offset, last: offset + from}

    if (to && to <= from) || (from > opts[:start] && info.duration && from >= info.duration) do
      {[{:complete, state.last}], state}
    else
      settings =
        opts
        |> Keyword.drop([:path, :start_time, :on_damage, :info])
        |> Keyword.merge(start: from, end: to)

      case Decoder.open(opts[:path], info, settings) do
        {:ok, decoder} -> {[], %{state | decoder: decoder}}
        {:error, error} -> raise error
      end
    end
  end

  @impl true
  def handle_demand(_n, _context, %{decoder: nil} = state), do: {[], state}

  # Emits one message at a time, whatever the demand, because images are large.
  def handle_demand(_n, _context, state) do
    case Decoder.next_item(state.decoder) do
      {:eof, decoder} ->
        complete_source(%{state | decoder: decoder})

      {:error, error, decoder} ->
        handle_damage(error, %{state | decoder: decoder})

      {kind, time, data, decoder} ->
        emit_frame(kind, time + state.offset, data, %{state | decoder: decoder})
    end
  end

  # All data has been delivered by now; raising the error earlier would have dropped some of it.
  @impl true
  def handle_stop(_final_time, _context, %{damage: nil} = state), do: {[], close_decoder(state)}
  def handle_stop(_final_time, _context, %{damage: error}), do: raise(error)

  @impl true
  def terminate(_reason, state), do: close_decoder(state)

  @impl true
  def describe(%{info: info, decoder: decoder}) do
    dropped = if decoder, do: decoder.dropped, else: 0
    "#{info.name} (#{info.format}), #{dropped} images with invalid times skipped"
  end

  defp emit_frame(kind, time, data, state),
    do: {[{kind, time, data}], %{state | last: max(state.last, time)}}

  defp complete_source(state), do: {[{:complete, state.last}], close_decoder(state)}

  defp handle_damage(error, %{opts: opts} = state) do
    case opts[:on_damage] do
      :error ->
        complete_source(%{state | damage: error})

      :warn ->
        Logger.warning(Exception.message(error))
        complete_source(state)
    end
  end

  defp close_decoder(%{decoder: nil} = state), do: state

  defp close_decoder(state) do
    Decoder.close(state.decoder)
    %{state | decoder: nil}
  end

  defp read_info!(path) do
    case FileInfo.read(path) do
      {:ok, info} -> info
      {:error, error} -> raise error
    end
  end

  defp output_ports(info, opts) do
    for {kind, type} <- outputs(), Map.fetch!(info, kind) && opts[kind], do: {kind, type}
  end

  defp no_stream_error(info) do
    Situ.Error.new(:no_stream, "#{info.name} has nothing to read with these options",
      fix: "enable at least one of video: and audio:"
    )
  end
end
