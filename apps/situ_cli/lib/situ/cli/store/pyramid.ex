defmodule Situ.CLI.Store.Pyramid do
  @moduledoc false
  # `situ store pyramid`: shows or builds the summaries from which timelines are drawn at any zoom
  # level.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, Progress, Recording, Verb}
  alias Situ.CLI.Store.Arguments
  alias Situ.{Error, Store, Time}
  alias Situ.Store.{NativeFormat, SegmentedRecording, Summary}

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "pyramid"],
        summary:
          "show a recording's summaries at a zoom level, or build them for an external file",
        about: """
        A store's pyramids (minimum, maximum, last value and message count in bins of 2^k ns) are built while it is
        written. For external files they are computed by reading the file; --build creates a store that contains them.
        """,
        arguments: [
          path: [
            kind: :recording,
            doc:
              "a store's folder, ROOT/NAME for its newest version NAME.NNNN, or an external file"
          ]
        ],
        options:
          Arguments.stream_options() ++
            [
              Option.new(:from, :time, "start at this originating time"),
              Option.new(:to, :time, "end at this originating time"),
              Option.new(:pixels, :integer, "the maximum number of columns", default: 20),
              Option.new(:build, :path, "create ROOT/NAME, a store with pyramids of all streams",
                value: "OUT"
              )
            ],
        examples: [
          "situ store pyramid recordings/lobby",
          "situ store pyramid recordings/lobby -s Lobby.Level --pixels 60 --json",
          "situ store pyramid drive.mcap --build recordings/drive"
        ],
        run: &run_pyramid/2
      }
    ]
  end

  defp run_pyramid(%{path: path}, opts) do
    unless opts[:pixels] in 1..100_000, do: throw({:usage, "--pixels must be 1 to 100000"})
    store = Recording.open!(path)
    infos = Arguments.select_streams!(store, opts)
    if opts[:build], do: build_pyramids(path, opts), else: show_summaries(store, infos, opts)
  end

  defp build_pyramids(path, opts) do
    copied =
      Progress.with_progress("build", opts, fn progress ->
        # Recording times are kept, so that the bins match the bins of the file itself.
        Store.copy(path, opts[:build], [times: :record] ++ Arguments.copy_options(opts, progress))
      end)

    made = Error.unwrap!(copied)
    if opts[:json], do: Output.print_json(%{path: made}), else: Output.puts(made)
    0
  end

  defp show_summaries(store, infos, opts) do
    stored? = store.module in [NativeFormat, SegmentedRecording]
    summaries = for info <- infos, info.count > 0, do: read_summary(store, info, stored?, opts)

    cond do
      opts[:json] -> Output.print_json(summaries)
      match?([_], summaries) and opts[:stream] != [] -> print_bins(hd(summaries))
      true -> print_overview(summaries)
    end

    0
  end

  defp read_summary(store, info, stored?, opts) do
    {from, to} = {opts[:from] || info.first, opts[:to] || info.last}
    if from > to, do: throw({:usage, "no messages between the given times"})
    began = System.monotonic_time(:microsecond)
    summary = Error.unwrap!(Summary.read(store, info.name, from, to, opts[:pixels]))

    %{
      stream: info.name,
      stored: stored?,
      width: summary.width,
      took_us: System.monotonic_time(:microsecond) - began,
      counts: Enum.map(summary.counts, &Tuple.to_list/1),
      tracks: Enum.map(summary.tracks, &track_json/1)
    }
  end

  defp track_json({key, {:numbers, bins}}) do
    bins =
      for {start, least, most, last, n} <- bins,
          do: %{start: start, min: least, max: most, last: last, count: n}

    %{key: key_text(key), kind: "numbers", bins: bins}
  end

  defp track_json({key, {:changes, changes}}) do
    changes = for {time, state} <- changes, do: %{time: time, state: state}
    %{key: key_text(key), kind: "changes", bins: changes}
  end

  defp track_json({key, {:states, bins}}) do
    bins =
      for {start, last, counts} <- bins do
        counts = for {state, n} <- counts, do: %{state: state, count: n}
        %{start: start, last: last, counts: counts}
      end

    %{key: key_text(key), kind: "states", bins: bins}
  end

  defp key_text(nil), do: nil
  defp key_text(key) when is_binary(key) or is_atom(key), do: to_string(key)
  defp key_text(key), do: inspect(key)

  defp print_overview(summaries) do
    head = ["stream", "pyramid", "tracks", "column", "columns", "took"]

    rows =
      for s <- summaries do
        tracks =
          Enum.map_join(s.tracks, ", ", fn t -> "#{if t.key, do: t.key <> ": "}#{t.kind}" end)

        from = if s.stored, do: "stored", else: "by reading"
        took = "#{Float.round(s.took_us / 1_000, 1)} ms"
        tracks = if tracks == "", do: "counts", else: tracks
        [s.stream, from, tracks, Time.format_duration(s.width), "#{length(s.counts)}", took]
      end

    Output.print_table([head | rows], 3)
  end

  defp print_bins(%{tracks: []} = s) do
    rows = for [start, n] <- s.counts, do: [Time.to_iso8601(start), "#{n}"]
    Output.print_table([["from", "messages"] | rows], 1)
  end

  defp print_bins(s) do
    for track <- s.tracks do
      if track.key, do: Output.puts("#{track.key}:")
      print_track(track)
    end
  end

  defp print_track(%{kind: "numbers", bins: bins}) do
    rows =
      for b <- bins,
          do: [Time.to_iso8601(b.start), "#{b.min}", "#{b.max}", "#{b.last}", "#{b.count}"]

    Output.print_table([["from", "least", "greatest", "last", "count"] | rows], 1)
  end

  defp print_track(%{kind: "changes", bins: changes}) do
    rows = for c <- changes, do: [Time.to_iso8601(c.time), "#{inspect(c.state)}"]
    Output.print_table([["at", "state"] | rows], 2)
  end

  defp print_track(%{kind: "states", bins: bins}) do
    rows =
      for b <- bins do
        counts = Enum.map_join(b.counts, ", ", &"#{inspect(&1.state)} #{&1.count}")
        [Time.to_iso8601(b.start), counts]
      end

    Output.print_table([["from", "messages by state"] | rows], 2)
  end
end
