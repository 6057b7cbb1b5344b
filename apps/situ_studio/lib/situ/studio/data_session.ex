defmodule Situ.Studio.DataSession do
  @moduledoc false
  # Handles the data requests of one page as pure functions; the socket only transports bytes.
  #
  # The page sends one JSON request at a time and receives one binary reply (`Situ.Studio.Frame`)
  # to each, so that the amount of data in flight is bounded by the page's own pace:
  #
  #     {"req": 7, "at": "1700000000000000000", "live": false, "snap": "Camera.Image",
  #      "open": [[1, {"stream": "Mic.Level", "viz": "line", "path": ""}]], "close": [],
  #      "series": [[1, FROM, TO, BIN]], "instant": [2]}
  #
  # `at` is the cursor, `series` lists windows in ns (as strings) with bins of BIN ns, and
  # `instant` lists the channels that show the message at the cursor. If `live` is true, the
  # newest time replaces `at`. With `snap`, the cursor moves to the nearest message of that
  # stream. `offset` shifts the second of two compared recordings (`Situ.Studio.Comparison`).
  # See docs/adr/0080-the-page-pulls-its-data.md.
  alias Situ.{Error, Studio}
  alias Situ.Studio.{Comparison, Draw, Frame, Visualizer, Visualizers, Int64, StreamReader}

  # A stream in a plot uses two channels: one for its window, and one for its value at the cursor.
  @max_channels 512
  @max_wants 512
  @max_bins 50_000
  # The limit for all windows of one request, enough for 25 plots on a screen of 8,000 pixels.
  @max_bins_at_once 200_000
  @max_span 4_000_000_000_000_000_000

  @enforce_keys [:source]
  defstruct [
    :source,
    visualizers: [],
    channels: %{},
    extent: %{from: 0, to: 1, live: false, version: 0}
  ]

  @type t :: %__MODULE__{
          source: Situ.Recording.t(),
          visualizers: [Visualizer.given()],
          channels: %{
            optional(Frame.channel()) => {Visualizer.spec() | {:error, String.t()}, term()}
          },
          extent: StreamReader.extent()
        }

  @doc "Creates a session for `source`; `visualizers` are the studio's additions to the built-in ones."
  @spec new(Situ.Recording.t(), [Visualizer.given()]) :: t()
  def new(source, visualizers \\ []), do: %__MODULE__{source: source, visualizers: visualizers}

  @doc "Returns the reply to one request. After `{:error, error}`, which rejects malformed input, close the socket."
  @spec handle_request(binary(), t()) :: {:ok, iodata(), t()} | {:error, Error.t()}
  def handle_request(text, %__MODULE__{} = session) do
    with {:ok, request} <- decode_request(text) do
      {state, session} = session |> align_sources(request["offset"]) |> refresh_extent()

      session =
        session
        |> close_channels(request["close"])
        |> open_channels(request["open"])
        |> request_shown_streams()

      time = cursor_time(session, request)
      windows = draw_windows(session, request["series"])
      {instants, session} = draw_instants(session, request["instant"], time)

      meta = %{
        request: request["req"],
        from: session.extent.from,
        to: session.extent.to,
        live: session.extent.live,
        version: session.extent.version,
        gone: state == :gone,
        replaced: state == :replaced,
        time: time
      }

      {:ok, Frame.encode_reply(windows ++ instants, meta), session}
    end
  end

  defp decode_request(text) do
    case Situ.JSON.decode(text) do
      {:ok, %{"req" => req} = request} when is_integer(req) and req in 0..4_294_967_295 ->
        {:ok, request}

      _ ->
        malformed_request()
    end
  end

  # Shifts the second of two compared recordings.
  defp align_sources(session, offset) do
    case Int64.parse(offset) do
      {:ok, offset} -> %{session | source: Comparison.set_offset(session.source, offset)}
      :error -> session
    end
  end

  defp malformed_request, do: {:error, Error.new(:bad_request, "invalid data request")}

  # A source that disappeared keeps its extent, so that the page does not move.
  defp refresh_extent(session) do
    case StreamReader.fetch_extent(session.source) do
      {:ok, extent} -> {:there, %{session | extent: extent}}
      {:error, %{code: :replaced}} -> {:replaced, mark_ended(session)}
      {:error, _} -> {:gone, mark_ended(session)}
    end
  end

  defp mark_ended(session), do: %{session | extent: %{session.extent | live: false}}

  # A page requests only windows with new data, but needs all streams that it shows to be captured.
  defp request_shown_streams(%{extent: %{live: true}, channels: channels} = session) do
    streams = for {_, {%{stream: stream}, _}} <- channels, uniq: true, do: stream
    StreamReader.request_streams(session.source, streams)
    session
  end

  defp request_shown_streams(session), do: session

  defp close_channels(session, ids) when is_list(ids),
    do: %{session | channels: Map.drop(session.channels, ids)}

  defp close_channels(session, _), do: session

  defp open_channels(session, wanted) when is_list(wanted) do
    Enum.reduce(wanted, session, fn
      [id, spec], session when is_integer(id) and id in 0..4_294_967_295 and is_map(spec) ->
        if map_size(session.channels) < @max_channels,
          do: put_in(session.channels[id], {parse_spec(spec, session.visualizers), nil}),
          else: session

      _, session ->
        session
    end)
  end

  defp open_channels(session, _), do: session

  defp parse_spec(%{"stream" => stream, "viz" => id} = spec, extra)
       when is_binary(stream) and is_binary(id) do
    with {:ok, path} <- Studio.ValuePath.parse(spec["path"] || ""),
         {:ok, viz} <- Visualizers.fetch_by_id(id, extra) do
      props = if is_map(spec["props"]), do: spec["props"], else: %{}
      %{stream: stream, viz: viz, path: path, props: props}
    else
      :error -> {:error, "there is no visualizer named #{inspect(id)}"}
      {:error, error} -> {:error, error.what}
    end
  end

  defp parse_spec(_, _), do: {:error, "a channel needs \"stream\" and \"viz\""}

  defp cursor_time(%{extent: extent}, %{"live" => true}), do: extent.to

  defp cursor_time(session, request) do
    time =
      case Int64.parse(request["at"]) do
        {:ok, time} -> time
        :error -> session.extent.from
      end

    with stream when is_binary(stream) <- request["snap"],
         {:ok, message} <- StreamReader.fetch_nearest(session.source, stream, time) do
      message.originating_time
    else
      _ -> time
    end
  end

  defp draw_windows(session, wants) when is_list(wants) do
    {frames, _bins} =
      wants
      |> Enum.take(@max_wants)
      |> Enum.map_reduce(0, fn want, bins ->
        bins = bins + count_bins(want)
        {if(bins > @max_bins_at_once, do: too_many(want), else: draw_window(session, want)), bins}
      end)

    Enum.reject(frames, &is_nil/1)
  end

  defp draw_windows(_, _), do: []

  defp count_bins([_id, from, to, bin]) when is_number(bin) and bin >= 1 do
    case {Int64.parse(from), Int64.parse(to)} do
      {{:ok, from}, {:ok, to}} when to > from -> div(to - from, trunc(bin)) + 1
      _ -> 0
    end
    |> allowed_bins()
  end

  defp count_bins(_want), do: 0

  # A window that exceeds the limit on its own is rejected anyway, so it does not count.
  defp allowed_bins(bins), do: if(bins > @max_bins + 1, do: 0, else: bins)

  defp too_many([id | _]) when is_integer(id) and id in 0..4_294_967_295,
    do: Frame.error(id, "the windows of this request have too many bins in total")

  defp too_many(_want), do: nil

  defp draw_window(session, [id, from, to, bin]) do
    with {:ok, {spec, _}} <- Map.fetch(session.channels, id),
         {:ok, from} <- Int64.parse(from),
         {:ok, to} when to >= from <- Int64.parse(to),
         bin when is_number(bin) and bin >= 1 and bin < @max_span <- bin do
      bin = trunc(bin)

      cond do
        match?({:error, _}, spec) -> Frame.error(id, elem(spec, 1))
        div(to - from, bin) > @max_bins -> Frame.error(id, "this window has too many bins")
        true -> Draw.draw_window(session.source, id, spec, from, to, bin)
      end
    else
      _ -> nil
    end
  end

  defp draw_window(_, _), do: nil

  defp draw_instants(session, ids, time) when is_list(ids) do
    ids
    |> Enum.take(@max_wants)
    |> Enum.flat_map_reduce(session, fn id, session ->
      case session.channels do
        %{^id => {{:error, what}, _}} ->
          {[Frame.error(id, what)], session}

        %{^id => {spec, last}} ->
          {frame, last} = Draw.draw_instant(session.source, id, spec, time, last)
          {[frame], put_in(session.channels[id], {spec, last})}

        _ ->
          {[], session}
      end
    end)
  end

  defp draw_instants(session, _, _), do: {[], session}
end
