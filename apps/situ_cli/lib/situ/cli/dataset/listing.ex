defmodule Situ.CLI.Dataset.Listing do
  @moduledoc false
  # Lists the contents of a dataset or of one session, as text or (`--json`) as JSON.
  alias Situ.CLI.{Output, TaskCode}
  alias Situ.Dataset
  alias Situ.Dataset.{OpenSession, Partition, Session, Summary}
  alias Situ.Time

  @doc "Lists the sessions selected by `--tag` and `--name`. Returns status 1 if any of their recordings is unreadable."
  @spec list_sessions(Dataset.t(), keyword()) :: 0 | 1
  def list_sessions(dataset, opts) do
    sessions = Dataset.select_sessions(dataset, tags: opts[:tag], name: opts[:name] || "*")
    selection = %{dataset | sessions: sessions}
    summaries = Dataset.session_summaries(selection)

    if opts[:json],
      do: Output.print_json(dataset_json(selection, summaries)),
      else: print_dataset(selection, summaries)

    if Enum.any?(summaries, fn {_, s} -> s.unknown > 0 end), do: 1, else: 0
  end

  @doc "Lists the recordings of one session and their streams."
  @spec show_session(Session.t(), keyword()) :: 0
  def show_session(session, opts) do
    if opts[:json],
      do: Output.print_json(session_json(session, Session.summary(session))),
      else: print_session(session)

    0
  end

  defp print_dataset(dataset, summaries) do
    Output.puts("#{dataset.name}  (#{dataset.file || "not saved"})")
    total = Summary.sum(Enum.map(summaries, &elem(&1, 1)))
    length = Time.format_duration(Enum.sum(for {_, s} <- summaries, do: Summary.duration(s)))

    Output.puts(
      "  #{Output.format_count(length(summaries), "session")}, #{Output.format_count(total.messages, "message")} in " <>
        "#{Output.format_count(total.streams, "stream")}, #{Output.format_bytes(total.size)}, #{length} in all"
    )

    head = ["session", "tags", "from", "length", "partitions", "streams", "messages", "size", ""]

    rows =
      for {session, {_, s}} <- Enum.zip(dataset.sessions, summaries), do: session_row(session, s)

    if rows != [], do: Output.print_table([head | rows], 3)

    for {session, partition, error} <- unreadable_partitions(dataset, summaries),
        do: Output.warn("#{session}/#{partition}: #{error.what}")

    outdated = TaskCode.list_outdated(dataset)
    if outdated != [], do: Output.puts("Outdated (`situ dataset refresh` makes them again):")
    Enum.each(outdated, &TaskCode.print_entry/1)
  end

  defp session_row(session, s) do
    from =
      if s.messages > 0,
        do: s.originating.left |> Time.to_iso8601() |> String.slice(0, 19),
        else: "-"

    state = if s.unknown > 0, do: "#{s.unknown} unreadable", else: ""

    [session.name, Enum.join(session.tags, " "), from, Time.format_duration(Summary.duration(s))] ++
      [
        "#{length(session.partitions)}",
        "#{s.streams}",
        "#{s.messages}",
        Output.format_bytes(s.size),
        state
      ]
  end

  defp unreadable_partitions(dataset, summaries) do
    for {session, {_, %{unknown: n}}} <- Enum.zip(dataset.sessions, summaries),
        n > 0,
        partition <- session.partitions,
        {:error, error} <- [Partition.open(partition)],
        do: {session.name, partition.name, error}
  end

  defp dataset_json(dataset, summaries) do
    %{
      name: dataset.name,
      file: dataset.file,
      tags: dataset.tags,
      metadata: dataset.metadata,
      sessions:
        for(
          {session, {_, s}} <- Enum.zip(dataset.sessions, summaries),
          do: session_json(session, s)
        )
    }
  end

  defp session_json(session, summary) do
    partitions =
      for p <- session.partitions do
        state =
          case Partition.summary(p) do
            {:ok, s} -> summary_json(s)
            {:error, error} -> %{error: error.what}
          end

        Map.merge(
          %{name: p.name, path: p.path, checksum: p.checksum, metadata: p.metadata},
          state
        )
      end

    Map.merge(summary_json(summary), %{
      name: session.name,
      tags: session.tags,
      metadata: session.metadata,
      partitions: partitions
    })
  end

  defp summary_json(s) do
    {from, to} =
      if s.messages > 0, do: {s.originating.left, s.originating.right}, else: {nil, nil}

    %{from: from, to: to, streams: s.streams, messages: s.messages, size: s.size}
  end

  defp print_session(session) do
    Output.puts("#{session.name}  #{Enum.map_join(session.tags, " ", &("#" <> &1))}")

    for {key, value} <- Enum.sort(session.metadata),
        do: Output.puts("  #{key}: #{Situ.JSON.encode(value)}")

    rows =
      for p <- session.partitions do
        case Partition.summary(p) do
          {:ok, s} ->
            [p.name, p.path, "#{s.streams}", "#{s.messages}", Output.format_bytes(s.size), ""]

          {:error, error} ->
            [p.name, p.path, "-", "-", "-", error.what]
        end
      end

    Output.print_table([["partition", "path", "streams", "messages", "size", ""] | rows], 2)
    open = OpenSession.open(session)

    streams =
      for {partition, info} <- OpenSession.list_streams(open) do
        [
          OpenSession.shortest_address(open, partition, info.name),
          info.type_name,
          "#{info.count}"
        ]
      end

    if streams != [], do: Output.print_table([["stream", "type", "messages"] | streams], 2)
  end
end
