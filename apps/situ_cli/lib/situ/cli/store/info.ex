defmodule Situ.CLI.Store.Info do
  @moduledoc false
  # `situ store info`: prints an overview of recordings.
  alias Situ.Bridge.Mcap
  alias Situ.{Store, Time}
  alias Situ.CLI.{Output, Recording}
  alias Situ.CLI.Store.Details
  alias Situ.Store.StreamInfo

  @doc "Prints the details of one recording, or one line for each of several recordings or those in a folder."
  @spec run([Path.t()], keyword()) :: 0 | 1
  def run([path], opts) do
    if folder?(path) or (opts[:json] && opts[:stream] == nil),
      do: list([path], opts),
      else: one(path, opts)
  end

  def run(paths, opts), do: list(paths, opts)

  defp folder?(path),
    do: File.dir?(path) and not Store.exists?(path)

  # Unreadable recordings are listed as errors. If the only given recording is unreadable, the command fails.
  defp list(paths, opts) do
    stores =
      Enum.flat_map(paths, &if(folder?(&1), do: Store.list(&1, recursive: true), else: [&1]))

    opened = for path <- stores, do: {path, Store.open(path)}
    with {[path], [{path, {:error, error}}]} <- {paths, opened}, do: raise(error)

    if opts[:json] do
      Output.json(Enum.map(opened, &entry/1))
    else
      if stores == [], do: Output.puts("No stores in #{Enum.join(paths, ", ")}.")
      Enum.each(opened, &Output.puts(short(&1)))
    end

    if Enum.all?(opened, &match?({_, {:ok, _}}, &1)), do: 0, else: 1
  end

  defp entry({_path, {:ok, store}}), do: json(store)
  defp entry({path, {:error, error}}), do: %{path: path, error: error.what}

  defp short({path, opened}) do
    case opened do
      {:ok, store} ->
        streams = Store.streams(store)

        "#{store.path}  #{Output.number(length(streams), "stream")}, #{span(streams)}, " <>
          "#{Output.bytes(Recording.size(store.path))}, #{state(Store.info(store))}"

      {:error, error} ->
        "#{path}  #{error.what}"
    end
  end

  defp one(path, opts) do
    store = Store.open!(path)

    if name = opts[:stream],
      do: Details.print(store, name, opts[:json] == true),
      else: text(store)

    0
  end

  defp text(store) do
    info = Store.info(store)
    streams = Store.streams(store)
    Output.puts("#{info.name}  (#{store.path})")

    Output.puts(
      "  #{state(info)}; #{Output.number(length(streams), "stream")}, " <>
        "#{Output.number(count(streams), "message")}, " <>
        "#{Output.bytes(Recording.size(store.path))} on disk"
    )

    case Store.interval(streams) do
      nil ->
        :ok

      {first, last} ->
        Output.puts(
          "  #{Time.to_iso8601(first)} .. #{Time.to_iso8601(last)}, #{Time.format_duration(last - first)}" <>
            if(Details.real_time?(first), do: "", else: " (not real time)")
        )
    end

    for line <- pieces(store, info), do: Output.puts("  " <> line)
    table(store, streams)
    for line <- foreign(store, info), do: Output.puts("  " <> line)

    for line <- damage(store, info), do: Output.puts("  DAMAGED " <> line)

    for file <- Store.missing_files(store) do
      Output.puts("  DAMAGED: #{file} is missing; `situ store verify '#{store.path}'`")
    end
  end

  # The name of a recording with several segments opens the newest segment.
  defp pieces(store, %{piece: %{}, name: name}) do
    root = Path.dirname(store.path)
    count = Enum.count(Store.list(root), &(Store.Folder.name(&1) == name))

    if count > 1,
      do: [
        "segment of a recording in #{count} segments: `situ store info '#{Path.join(root, name)}.*'`"
      ],
      else: []
  end

  defp pieces(_store, _info), do: []

  # Describes properties that external files contain about themselves.
  defp foreign(store, info) do
    written =
      [info[:written_by], info[:profile]]
      |> Enum.reject(&(&1 in [nil, ""]))
      |> Enum.join(", profile ")

    [
      written != "" && "written by #{Output.name(written)}",
      attachments(store) != [] &&
        "#{Output.number(length(attachments(store)), "attachment")}: `situ store attachments '#{store.path}'`"
    ]
    |> Enum.filter(& &1)
    |> Kernel.++(
      for {name, pairs} <- info[:metadata] || [],
          do: "metadata #{Output.name(name)}: #{pairs(pairs)}"
    )
    |> Kernel.++(for note <- info[:notes] || [], do: "note: #{Output.name(note)}")
  end

  defp pairs(pairs),
    do: Enum.map_join(pairs, ", ", fn {key, value} -> Output.name("#{key}=#{value}") end)

  defp attachments(%{module: Mcap} = store), do: Mcap.attachments(store)
  defp attachments(_store), do: []

  # Only Situ's own files have checksums to verify. For an external file, the first damaged positions are listed.
  defp damage(_store, %{damage: []}), do: []

  defp damage(%{module: Store.Local} = store, info),
    do: [
      "in #{Output.number(length(info.damage), "position")}: `situ store verify '#{store.path}'`"
    ]

  defp damage(_store, info) do
    shown = for place <- Enum.take(info.damage, 5), do: told(place)

    more = length(info.damage) - length(shown)
    shown ++ if(more > 0, do: ["at #{Output.number(more, "more position")}"], else: [])
  end

  # Some readers of external files describe damage as a sentence.
  defp told(sentence) when is_binary(sentence), do: sentence
  defp told(place), do: "at byte #{place[:offset]}: #{place[:why]}"

  defp table(_store, []), do: :ok

  defp table(store, streams) do
    head = ~w(stream type messages rate size avg latency gaps)
    Output.table([head | Enum.map(streams, &row(store, &1))], 2)
  end

  defp row(store, info) do
    [
      info.name <> if(info.large?, do: "*", else: ""),
      info.type_name,
      Integer.to_string(info.count),
      Details.rate(info),
      Details.format_bytes(store, info, info.stored),
      Details.format_bytes(store, info, StreamInfo.average_size(info)),
      Details.latency(store, info),
      gaps(store, info)
    ]
  end

  # A gap is longer than ten times the average period, and at least 100 ms.
  defp gaps(store, info) do
    case StreamInfo.rate(info) do
      nil ->
        "-"

      rate ->
        least = max(round(10.0e9 / rate), 100_000_000)

        case Store.gaps(store, info, least) do
          [] ->
            "-"

          gaps ->
            longest = gaps |> Enum.map(fn {a, b} -> b - a end) |> Enum.max()
            "#{length(gaps)}, longest #{Time.format_duration(longest)}"
        end
    end
  end

  defp count(streams), do: streams |> Enum.map(& &1.count) |> Enum.sum()

  defp span(streams) do
    case Store.interval(streams) do
      nil -> "empty"
      {first, last} -> Time.format_duration(last - first)
    end
  end

  defp state(%{live?: true}), do: "being written"
  defp state(%{closed?: true}), do: "closed"

  defp state(_),
    do: "not closed (its writer was killed; it is readable, and `situ store repair` closes it)"

  defp json(store) do
    info = Store.info(store)

    %{
      name: info.name,
      path: store.path,
      closed: info.closed?,
      live: info.live?,
      created: info.created,
      size: Recording.size(store.path),
      damage: length(info.damage),
      missing_files: Store.missing_files(store),
      streams: Enum.map(Store.streams(store), &Details.json(store, &1))
    }
    |> Map.merge(
      if(info[:metadata] in [nil, []], do: %{}, else: %{metadata: Map.new(info.metadata)})
    )
    |> Map.merge(if(attachments(store) == [], do: %{}, else: %{attachments: attachments(store)}))
  end
end
