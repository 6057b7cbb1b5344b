defmodule Situ.CLI.Store.Inspection do
  @moduledoc false
  # The verbs of `situ store` that only read: info, messages, stats, analyze, diff.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, Recording, Verb}
  alias Situ.CLI.Store.{Arguments, McapStructure, Diff, Info, Lag, Messages, Statistics}
  alias Situ.{Error, Store, Time}

  @recording [
    kind: :recording,
    doc:
      "a store's folder, ROOT/NAME for all segments or the newest version NAME.NNNN, or an external file"
  ]

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "info"],
        aliases: ["list", "ls"],
        summary: "list the streams of a recording: types, rates, gaps, sizes, latency",
        about: """
        Several recordings, or a folder of recordings, are listed one per line, and then the other files in the folder
        that Situ can open. Gaps are measured between chunks of the file; `situ store stats` measures every message.
        --json prints a list of recordings, even for a single one; with --stream it prints that stream. A recording in
        segments (ROOT/NAME) is one recording, over restarts of its recorder; --segments lists its segments.
        """,
        arguments: [path: Keyword.put(@recording, :many, true)],
        options: [
          Option.new(
            :stream,
            :string,
            "all details of one stream (with --show schemas: a schema's definition)",
            short: :s,
            value: "NAME"
          ),
          Option.new(:segments, :flag, "list the segments of a recording that is split"),
          Option.new(
            :show,
            McapStructure.part_names(),
            "MCAP: show this part of the file instead of the streams"
          )
        ],
        examples: [
          "situ store info recordings/lobby",
          "situ store info recordings --json",
          "situ store info recordings/hall --segments",
          "situ store info drive.mcap --show chunks"
        ],
        run: &show_info/2
      },
      %Verb{
        words: ["store", "messages"],
        aliases: ["cat", "echo"],
        summary: "print messages: time, latency, data",
        arguments: [path: @recording],
        options: [
          Option.new(
            :stream,
            :string,
            "a stream, or a pattern ('Room.*'); default: all, in order of time",
            short: :s,
            value: "NAME",
            many?: true
          ),
          Option.new(:number, :integer, "the number of messages; 0 for all",
            short: :n,
            default: 10
          ),
          Option.new(:from, :time, "start at this originating time"),
          Option.new(:to, :time, "end at this originating time"),
          Option.new(
            :skip_damage,
            :flag,
            "omit damaged data; without this flag it is an error"
          )
        ],
        examples: [
          "situ store messages recordings/lobby",
          "situ store messages recordings/lobby -s Lobby.Speaking -n 0 --json"
        ],
        run: &show_messages/2
      },
      %Verb{
        words: ["store", "stats"],
        summary: "measure every stream: periods, jitter, gaps, latency percentiles",
        about: "Reads the times of every message. Percentiles are accurate to half a percent.",
        arguments: [path: @recording],
        options: [
          Option.new(:stream, :string, "only this stream", short: :s, value: "NAME", many?: true),
          Option.new(
            :gap,
            :span,
            "count longer pauses as gaps (default: ten times the stream's period, at least 100 ms)"
          )
        ],
        examples: ["situ store stats recordings/lobby --gap 1s"],
        run: &show_statistics/2
      },
      %Verb{
        words: ["store", "analyze"],
        summary: "find streams whose messages arrive late compared to other streams",
        about:
          "The lag is how long, in creation time, a replay in order of originating times would wait for the stream.",
        arguments: [path: @recording],
        options: [
          Option.new(:order, ["avg", "max"], "sort by the average or the greatest lag",
            short: :o,
            default: "avg"
          )
        ],
        examples: ["situ store analyze recordings/lobby -o max"],
        run: &analyze_lags/2
      },
      %Verb{
        words: ["store", "diff"],
        summary: "compare two recordings, message by message; status 1 if they differ",
        arguments: [first: @recording, second: @recording],
        options: [
          Option.new(:envelopes, :flag, "also compare creation times and sequence numbers")
        ],
        examples: ["situ store diff recordings/lobby.0000 recordings/lobby.0001"],
        run: &compare_recordings/2
      }
    ]
  end

  defp show_info(%{path: paths}, opts) do
    paths = Recording.expand_patterns(paths)
    Recording.load_formats(paths)

    if opts[:show],
      do: McapStructure.show_part(paths, opts[:show], opts),
      else: Info.show_recordings(paths, opts)
  end

  defp show_messages(%{path: path}, opts) do
    if (opts[:number] || 0) < 0, do: throw({:usage, "--number must be 0 or greater"})
    store = Recording.open!(path)
    names = for info <- Arguments.select_streams!(store, opts), do: info.name
    Messages.print_messages(store, names, opts)
  end

  defp show_statistics(%{path: path}, opts) do
    store = Recording.open!(path)

    stats =
      for info <- resolve_streams(store, opts[:stream]),
          do: Statistics.measure_stream(store, info, opts[:gap])

    if opts[:json], do: Output.print_json(stats), else: print_statistics(stats)
    0
  end

  defp resolve_streams(store, []), do: Store.streams(store)

  defp resolve_streams(store, names) do
    for name <- names do
      case Store.stream_info(store, name) do
        {:ok, info} -> info
        {:error, error} -> raise error
      end
    end
  end

  defp print_statistics(stats) do
    head = [
      "stream",
      "messages",
      "rate",
      "period",
      "jitter",
      "p99",
      "longest",
      "gaps",
      "latency p50",
      "p95",
      "p99"
    ]

    rows =
      for s <- stats do
        [
          s.stream,
          "#{s.messages}",
          format_rate(s.rate),
          format_span(s.period_mean),
          format_span(s.period_deviation),
          format_span(s.period_p99)
        ] ++
          [
            format_span(s.period_most),
            format_gaps(s),
            format_span(s.latency_p50),
            format_span(s.latency_p95),
            format_span(s.latency_p99)
          ]
      end

    Output.print_table([head | rows], 1)
  end

  defp format_rate(nil), do: "-"
  defp format_rate(hz), do: "#{Float.round(hz, 2)} Hz"
  defp format_span(nil), do: "-"
  defp format_span(ns), do: Time.format_duration(round(ns))
  defp format_gaps(%{gaps: 0}), do: "-"
  defp format_gaps(s), do: "#{s.gaps} (#{Time.format_duration(s.gap_time)})"

  defp analyze_lags(%{path: path}, opts) do
    lags =
      path
      |> Recording.open!()
      |> Lag.measure_lags(if(opts[:order] == "max", do: :most, else: :average))

    if opts[:json] do
      Output.print_json(lags)
    else
      rows =
        for lag <- lags,
            do: [lag.stream, "#{lag.messages}", format_span(lag.average), format_span(lag.most)]

      Output.print_table([["stream", "messages", "average lag", "greatest"] | rows], 1)
    end

    0
  end

  defp compare_recordings(%{first: first, second: second}, opts) do
    differences = Diff.compare_stores(Recording.open!(first), Recording.open!(second), opts)
    same? = Enum.all?(differences, & &1.same)

    if opts[:json],
      do: Output.print_json(%{same: same?, streams: differences}),
      else: for(d <- differences, do: Output.puts(describe_difference(d)))

    if same?, do: 0, else: 1
  rescue
    # Damage is reported as an error, not as a difference, because nothing after it was compared.
    error in Error -> raise error
  end

  defp describe_difference(%{only: where} = d) when where != nil,
    do:
      "#{Output.format_name(d.stream)}: only in the #{where} (#{Output.format_count(d.messages, "message")})"

  defp describe_difference(%{same: true} = d),
    do: "#{Output.format_name(d.stream)}: the same (#{Output.format_count(d.equal, "message")})"

  defp describe_difference(d) do
    types = if d.types, do: "types #{Enum.join(d.types, " and ")}; ", else: ""
    at = if d.at, do: "; the first difference at #{Time.to_iso8601(d.at)}", else: ""

    "#{Output.format_name(d.stream)}: #{types}#{d.equal} equal, #{d.different} different, " <>
      "#{d.only_first} only in the first, #{d.only_second} only in the second#{at}"
  end
end
