defmodule Situ.CLI.Query do
  @moduledoc false
  # `situ store query` and `situ dataset query`: find the intervals in which an expression is
  # true.
  @behaviour Situ.CLI.Verb
  alias Situ.Annotation.{Edit, Layer, Schema}
  alias Situ.CLI.{Option, Output, Progress, Verb}
  alias Situ.Dataset
  alias Situ.Dataset.{OpenSession, Session}
  alias Situ.{Query, Time}

  @about """
  The language is described in docs/guides/expressions.md. Streams are written by name, in backticks if the name
  contains dots; latency(S) and age(S) refer to a stream's latest message.
  """

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "query"],
        summary: "find the intervals in which an expression over streams is true",
        about: @about,
        arguments: [
          path: [kind: :recording, doc: "a recording"],
          expression: [kind: :text, doc: "the condition"]
        ],
        options: search_options(),
        examples: [
          "situ store query recordings/lobby '`Lobby.Speaking` and age(`Lobby.Level`) > 1s'"
        ],
        run: &run_query/2
      },
      %Verb{
        words: ["dataset", "query"],
        summary: "find the intervals in which an expression is true, in every session",
        about: @about,
        arguments: [
          path: [kind: :recording, doc: "a dataset file, or a folder of recordings"],
          expression: [kind: :text, doc: "the condition"]
        ],
        options:
          search_options() ++
            [
              Option.new(:tag, :string, "only sessions with this tag", many?: true),
              Option.new(:name, :string, "only sessions whose name matches this pattern",
                value: "PATTERN"
              ),
              Option.new(
                :annotate,
                :string,
                "save the intervals as proposals: a new partition of this name in every session",
                value: "PARTITION"
              )
            ],
        examples: [
          "situ dataset query study.json \"Speech.P1.Speech == 'laughs'\" --least 200ms --annotate Laughs"
        ],
        run: &run_query/2
      }
    ]
  end

  defp search_options do
    [
      Option.new(:from, :time, "start at this originating time"),
      Option.new(:to, :time, "end at this originating time"),
      Option.new(:least, :span, "omit shorter intervals", default: 0),
      Option.new(:join, :span, "close gaps no longer than this", default: 0),
      Option.new(:hold, :span, "how long a value is valid (default: until the next message)"),
      Option.new(:limit, :integer, "maximum number of intervals per session", default: 100_000)
    ]
  end

  defp run_query(%{path: path, expression: expression}, opts) do
    dataset = Situ.CLI.Dataset.open_dataset!(path)
    _ = Situ.Expression.parse!(expression)
    sessions = Dataset.select_sessions(dataset, tags: opts[:tag] || [], name: opts[:name] || "*")
    total = length(sessions)

    found =
      Progress.with_progress("query", opts, fn progress ->
        for {session, n} <- Enum.with_index(sessions, 1) do
          result = Query.run(OpenSession.open(session), expression, query_options(opts))
          progress.(n, total)
          {session, result}
        end
      end)

    # A missing stream is an error if there is only one session; other sessions of a dataset may have the stream.
    case found do
      [{_, {:error, error}}] -> raise error
      _ -> report_results(found, opts)
    end

    if opts[:annotate], do: save_proposals(dataset, found, expression, opts)
    if Enum.any?(found, &match?({_, {:error, _}}, &1)), do: 1, else: 0
  end

  defp query_options(opts) do
    [timeout: 24 * 3_600_000] ++
      Enum.filter(Keyword.take(opts, [:from, :to, :least, :join, :hold, :limit]), fn {_, v} ->
        v != nil
      end)
  end

  defp report_results(found, opts) do
    if opts[:json] do
      Output.print_json(for {session, result} <- found, do: result_json(session, result))
    else
      several? = match?([_, _ | _], found)
      for {session, result} <- found, do: print_result(session, result, several?)
    end
  end

  defp result_json(session, {:ok, found}) do
    intervals = for {from, to} <- found.intervals, do: %{from: from, to: to}
    %{session: session.name, intervals: intervals, truncated: found.truncated?}
  end

  defp result_json(session, {:error, error}), do: %{session: session.name, error: error.what}

  defp print_result(session, {:ok, found}, several?) do
    prefix = if several?, do: Output.format_name(session.name) <> "  ", else: ""

    for {from, to} <- found.intervals,
        do:
          Output.puts(
            "#{prefix}#{Time.to_iso8601(from)}  #{Time.to_iso8601(to)}  #{Time.format_duration(to - from)}"
          )

    if found.truncated?, do: Output.warn("#{prefix}more intervals exist; raise --limit")
  end

  defp print_result(session, {:error, error}, _several?),
    do: Output.warn("#{session.name}: #{error.what}")

  # Writes a partition for each session with results, in the same folder as the session's first partition.
  defp save_proposals(dataset, found, expression, opts) do
    name = opts[:annotate]
    schema = Schema.text("Query")

    written =
      for {session, {:ok, %{intervals: [_ | _]} = found}} <- found do
        {:ok, empty} = Layer.new(schema)
        proposals = Query.annotations(found, name, %{"Query" => expression}, by: "situ query")
        {:ok, layer, _} = Edit.add_proposals(empty, proposals)
        folder = session.partitions |> hd() |> Map.fetch!(:path) |> Path.dirname()
        path = unwrap!(Situ.Annotation.Recording.write(layer, Path.join(folder, name), name))
        {session.name, Dataset.Partition.new(name, path)}
      end

    if dataset.file,
      do: unwrap!(Dataset.update(dataset, &put_all(&1, written))),
      else:
        Output.warn(
          "the partitions were written; run `situ dataset create` on the folder to list them"
        )
  end

  defp put_all(dataset, written) do
    Enum.reduce_while(written, {:ok, dataset}, fn {name, partition}, {:ok, dataset} ->
      case Dataset.update_session(dataset, name, &put_partition(&1, partition)) do
        {:ok, dataset} -> {:cont, {:ok, dataset}}
        error -> {:halt, error}
      end
    end)
  end

  defp put_partition(session, partition) do
    case Session.fetch_partition(session, partition.name) do
      {:ok, _} -> Session.replace_partition(session, partition)
      {:error, _} -> Session.add_partition(session, partition)
    end
  end

  defp unwrap!({:ok, value}), do: value
  defp unwrap!({:error, error}), do: raise(error)
end
