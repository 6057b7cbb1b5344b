defmodule Situ.CLI.Store.Info do
  @moduledoc false
  # `situ store info`: prints an overview of recordings.
  alias Situ.Bridge.Mcap
  alias Situ.{Store, Time}
  alias Situ.CLI.{Output, Recording}
  alias Situ.CLI.Store.StreamDetails
  alias Situ.Recording.Formats
  alias Situ.Store.{Folder, StreamInfo}

  @most_files 50

  @doc "Prints the details of one recording, or one line for each of several recordings or those in a folder."
  @spec show_recordings([Path.t()], keyword()) :: 0 | 1
  def show_recordings([path], opts) do
    if recordings_folder?(path) or (opts[:json] && opts[:stream] == nil),
      do: list_recordings([path], opts),
      else: show_recording(path, opts)
  end

  def show_recordings(paths, opts), do: list_recordings(paths, opts)

  defp recordings_folder?("s3://" <> _ = address), do: Store.list(address, recursive: true) != []
  defp recordings_folder?(path), do: File.dir?(path) and not Store.exists?(path)

  defp describe_location("s3://" <> _), do: "in object storage"
  defp describe_location(_path), do: "on disk"

  # Unreadable recordings are listed as errors. If the only given recording is unreadable, the command fails.
  defp list_recordings(paths, opts) do
    stores =
      Enum.flat_map(
        paths,
        &if(recordings_folder?(&1), do: Store.list(&1, recursive: true), else: [&1])
      )

    opened = for path <- stores, do: {path, Store.open(path)}
    with {[path], [{path, {:error, error}}]} <- {paths, opened}, do: raise(error)

    if opts[:json] do
      Output.print_json(Enum.map(opened, &entry_json/1))
    else
      if stores == [], do: Output.puts("No stores in #{Enum.join(paths, ", ")}.")
      Enum.each(opened, &Output.puts(short_line(&1)))
      paths |> Enum.filter(&File.dir?/1) |> Enum.flat_map(&list_files/1) |> print_files()
    end

    if Enum.all?(opened, &match?({_, {:ok, _}}, &1)), do: 0, else: 1
  end

  defp list_files(path),
    do: if(recordings_folder?(path), do: Folder.list_readable_files(path), else: [])

  defp print_files([]), do: :ok

  # Opening a large file can take minutes, so only its kind and size are printed.
  defp print_files(files) do
    count = Output.format_count(length(files), "file")
    Output.puts("#{count} that Situ can open (`situ store info FILE`, `situ studio FILE`):")

    for path <- Enum.take(files, @most_files), {:ok, %{size: size}} <- [File.stat(path)] do
      Output.puts("  #{path}  #{kind_title(path)}, #{Output.format_bytes(size)}")
    end

    rest = length(files) - @most_files
    if rest > 0, do: Output.puts("  ... and #{rest} more")
    :ok
  end

  defp kind_title(path) do
    extension = path |> Path.extname() |> String.downcase()
    kind = Enum.find(Formats.list_kinds(), &(&1.open != nil and extension in &1.extensions))
    if kind, do: kind.title, else: extension
  end

  defp entry_json({_path, {:ok, store}}), do: store_json(store)
  defp entry_json({path, {:error, error}}), do: %{path: path, error: error.what}

  defp short_line({path, opened}) do
    case opened do
      {:ok, store} ->
        streams = Store.streams(store)

        "#{store.path}  #{Output.format_count(length(streams), "stream")}, #{format_length(streams)}, " <>
          "#{Output.format_bytes(Recording.disk_size(store))}, #{count_segments(store)}" <>
          store_state(Store.info(store))

      {:error, error} ->
        "#{path}  #{error.what}"
    end
  end

  defp count_segments(store) do
    case length(Store.segments(store)) do
      0 -> ""
      count -> Output.format_count(count, "segment") <> ", "
    end
  end

  defp show_recording(path, opts) do
    store = Store.open!(path)

    cond do
      name = opts[:stream] -> StreamDetails.print_stream(store, name, opts[:json] == true)
      opts[:segments] -> print_segments(store)
      true -> print_overview(store)
    end

    0
  end

  defp print_overview(store) do
    info = Store.info(store)
    streams = Store.streams(store)
    Output.puts("#{info.name}  (#{store.path})")

    Output.puts(
      "  #{store_state(info)}; #{Output.format_count(length(streams), "stream")}, " <>
        "#{Output.format_count(count_messages(streams), "message")}, " <>
        "#{Output.format_bytes(Recording.disk_size(store))} #{describe_location(store.path)}"
    )

    case Store.interval(streams) do
      nil ->
        :ok

      {first, last} ->
        Output.puts(
          "  #{Time.to_iso8601(first)} .. #{Time.to_iso8601(last)}, #{Time.format_duration(last - first)}" <>
            if(StreamDetails.real_time?(first), do: "", else: " (not real time)")
        )
    end

    for line <- segment_lines(store, info), do: Output.puts("  " <> line)
    print_streams(store, streams)
    for line <- external_lines(store, info), do: Output.puts("  " <> line)

    for line <- damage_lines(store, info), do: Output.puts("  DAMAGED " <> line)

    for file <- Store.missing_files(store) do
      Output.puts("  DAMAGED: #{file} is missing; `situ store verify '#{store.path}'`")
    end
  end

  defp segment_lines(store, %{segments: count} = info) do
    runs = store |> Store.segments() |> Enum.uniq_by(& &1.run) |> length()
    {deleted, _messages} = info.deleted

    [
      "#{Output.format_count(count, "segment")} of #{Output.format_count(runs, "run")}: " <>
        "`situ store info '#{store.path}' --segments`"
      | if(deleted > 0, do: ["#{Output.format_count(deleted, "segment")} deleted since"], else: [])
    ]
  end

  # A segment that was opened by its own name.
  defp segment_lines(store, %{piece: %{}, name: name}),
    do: ["a segment of '#{Path.join(Path.dirname(store.path), name)}'"]

  defp segment_lines(_store, _info), do: []

  defp print_segments(store) do
    case Store.segments(store) do
      [] ->
        Output.puts("#{store.path} has no segments.")

      segments ->
        Output.print_table(
          [~w(segment start length messages size state) | segment_rows(segments)],
          0
        )
    end
  end

  defp segment_rows(segments) do
    for segment <- segments do
      [
        Path.basename(segment.path),
        if(segment.first, do: Time.to_iso8601(segment.first), else: "-"),
        if(segment.first, do: Time.format_duration(segment.last - segment.first), else: "empty"),
        Integer.to_string(segment.count),
        Output.format_bytes(Recording.path_size(segment.path)),
        short_state(segment)
      ]
    end
  end

  defp short_state(%{live?: true}), do: "being written"
  defp short_state(%{closed?: true}), do: "closed"
  defp short_state(_killed), do: "not closed"

  # Describes properties that external files contain about themselves.
  defp external_lines(store, info) do
    written =
      [info[:written_by], info[:profile]]
      |> Enum.reject(&(&1 in [nil, ""]))
      |> Enum.join(", profile ")

    [
      written != "" && "written by #{Output.format_name(written)}",
      list_attachments(store) != [] &&
        "#{Output.format_count(length(list_attachments(store)), "attachment")}: " <>
          "`situ store attachments '#{store.path}'`"
    ]
    |> Enum.filter(& &1)
    |> Kernel.++(
      for {name, pairs} <- info[:metadata] || [],
          do: "metadata #{Output.format_name(name)}: #{format_pairs(pairs)}"
    )
    |> Kernel.++(for note <- info[:notes] || [], do: "note: #{Output.format_name(note)}")
  end

  defp format_pairs(pairs),
    do: Enum.map_join(pairs, ", ", fn {key, value} -> Output.format_name("#{key}=#{value}") end)

  defp list_attachments(%{module: Mcap} = store), do: Mcap.list_attachments(store)
  defp list_attachments(_store), do: []

  # Only Situ's own files have checksums to verify. For an external file, the first damaged positions are listed.
  defp damage_lines(_store, %{damage: []}), do: []

  defp damage_lines(%{module: module} = store, info)
       when module in [Store.NativeFormat, Store.SegmentedRecording],
       do: [
         "in #{Output.format_count(length(info.damage), "position")}: `situ store verify '#{store.path}'`"
       ]

  defp damage_lines(_store, info) do
    lines = for damage <- Enum.take(info.damage, 5), do: Situ.Recording.describe_damage(damage)

    more = length(info.damage) - length(lines)
    lines ++ if(more > 0, do: ["at #{Output.format_count(more, "more position")}"], else: [])
  end

  defp print_streams(_store, []), do: :ok

  defp print_streams(store, streams) do
    head = ~w(stream type messages rate size avg latency gaps)
    Output.print_table([head | Enum.map(streams, &stream_row(store, &1))], 2)
  end

  defp stream_row(store, info) do
    [
      info.name <> if(info.large?, do: "*", else: ""),
      StreamDetails.format_type(info),
      Integer.to_string(info.count),
      StreamDetails.format_rate(info),
      StreamDetails.format_bytes(store, info, info.stored),
      StreamDetails.format_bytes(store, info, StreamInfo.average_size(info)),
      StreamDetails.format_latency(store, info),
      format_gaps(store, info)
    ]
  end

  # A gap is longer than ten times the average period, and at least 100 ms.
  defp format_gaps(store, info) do
    case StreamInfo.message_rate(info) do
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

  defp count_messages(streams), do: streams |> Enum.map(& &1.count) |> Enum.sum()

  defp format_length(streams) do
    case Store.interval(streams) do
      nil -> "empty"
      {first, last} -> Time.format_duration(last - first)
    end
  end

  defp store_state(%{live?: true}), do: "being written"
  defp store_state(%{closed?: true}), do: "closed"

  defp store_state(_),
    do: "not closed (its writer was killed; it is readable, and `situ store repair` closes it)"

  defp segment_json(segment) do
    %{
      path: segment.path,
      first: segment.first,
      last: segment.last,
      messages: segment.count,
      closed: segment.closed?,
      live: segment.live?
    }
  end

  defp store_json(store) do
    info = Store.info(store)

    %{
      name: info.name,
      path: store.path,
      closed: info.closed?,
      live: info.live?,
      created: info.created,
      size: Recording.disk_size(store),
      segments: Enum.map(Store.segments(store), &segment_json/1),
      damage: length(info.damage),
      missing_files: Store.missing_files(store),
      streams: Enum.map(Store.streams(store), &StreamDetails.stream_json(store, &1))
    }
    |> Map.merge(
      if(info[:metadata] in [nil, []], do: %{}, else: %{metadata: Map.new(info.metadata)})
    )
    |> Map.merge(
      if(list_attachments(store) == [], do: %{}, else: %{attachments: list_attachments(store)})
    )
  end
end
