defmodule Situ.Media.VideoWriter do
  @moduledoc """
  A sink that writes synchronized images and audio to one media file, each frame at its own time.

      Situ.Media.VideoWriter.write([video: clip.video, audio: clip.audio], "copy.mp4")

  The earliest first message becomes the file's time 0, so the sink waits until every input has sent a message (or 2 s
  of stream time have passed). Originating times are kept: `Situ.Media.VideoFile` returns the same times, within the
  precision of the file format (1/90,000 s in MP4, 1 ms in MKV and WebM). Data before the start of the file is skipped
  and counted.
  """

  alias Situ.{AudioBuffer, Image}
  alias Situ.Media.Encoder

  @wait 2_000_000_000
  @schema [
            path: [type: :string, required: true, doc: "The file; its extension sets the format."],
            expect: [
              type: {:list, {:in, [:video, :audio]}},
              default: [:video, :audio],
              doc: "The connected inputs; set by `write/3`."
            ]
          ] ++ Encoder.option_schema()

  use Situ.Component, inputs: [video: Image, audio: AudioBuffer], options: @schema

  require Logger

  # Maximum number of images that wait for the first audio buffer.
  @most_held 64

  @doc """
  Connects the sink to one or two streams. Besides the options above, `opts` may contain `name:`, `on_error:` and
  `policy:`.
  """
  @spec write([video: Situ.Stream.t(), audio: Situ.Stream.t()], Path.t(), keyword()) :: :ok
  def write([{_, _} | _] = streams, path, opts \\ []) do
    inputs = Keyword.take(inputs(), Keyword.keys(streams))
    own = [path: path, expect: Keyword.keys(inputs)]
    Situ.via(streams, __MODULE__, own ++ [inputs: inputs] ++ opts)
    :ok
  end

  @impl true
  def init(opts) do
    {:ok, %{opts: opts, held: [], seen: %{}, closed: [], encoder: nil, early: 0}}
  end

  @impl true
  def handle_message(input, message, _context, %{encoder: nil} = state) do
    %{data: data, originating_time: time} = message

    state = %{
      state
      | held: [{input, time, data} | state.held],
        seen: Map.put(state.seen, input, data)
    }

    {[], if(can_open?(state), do: open_encoder(state), else: state)}
  end

  def handle_message(input, message, _context, state),
    do: {[], write_item(input, message.originating_time, message.data, state)}

  @impl true
  def handle_closed(input, _time, _context, state) do
    state = %{state | closed: [input | state.closed]}
    state = if state.encoder == nil and state.held != [], do: open_encoder(state), else: state
    {[], if(state.opts[:expect] -- state.closed == [], do: close_encoder(state), else: state)}
  end

  @impl true
  def terminate(_reason, state), do: close_encoder(state)

  @impl true
  def describe(state), do: "#{Path.basename(state.opts[:path])}, #{state.early} too early"

  defp close_encoder(%{encoder: nil} = state), do: state

  defp close_encoder(%{encoder: encoder} = state) do
    case Encoder.close(encoder) do
      :ok -> %{state | encoder: nil}
      {:error, error} -> raise error
    end
  end

  # True if every kind has arrived, or one has waited long enough for the other.
  defp can_open?(%{seen: seen, held: held, opts: opts}) do
    times = Enum.map(held, &elem(&1, 1))

    map_size(seen) == length(opts[:expect]) or length(held) >= @most_held or
      Enum.max(times) - Enum.min(times) >= @wait
  end

  defp open_encoder(state) do
    start = state.held |> Enum.map(&start_of/1) |> Enum.min()
    audio = state.seen[:audio]

    opts =
      state.opts
      |> Keyword.drop([:path, :expect])
      |> Keyword.merge(video: state.seen[:video], audio: audio && audio.format, start_time: start)

    case Encoder.open(state.opts[:path], opts) do
      {:ok, encoder} ->
        held = Enum.reverse(state.held)
        state = %{state | encoder: encoder, held: [], seen: %{}}

        Enum.reduce(held, state, fn {input, time, data}, state ->
          write_item(input, time, data, state)
        end)

      {:error, error} ->
        raise error
    end
  end

  defp start_of({:video, time, _}), do: time
  defp start_of({:audio, time, buffer}), do: AudioBuffer.start_time(buffer, time)

  defp write_item(input, time, data, state) do
    case apply(Encoder, input, [state.encoder, time, data]) do
      :ok -> state
      {:error, %{code: :before_start} = error} -> count_early(error, state)
      {:error, error} -> raise error
    end
  end

  defp count_early(error, %{early: 0} = state) do
    Logger.warning(Exception.message(error))
    %{state | early: 1}
  end

  defp count_early(_error, state), do: %{state | early: state.early + 1}
end
