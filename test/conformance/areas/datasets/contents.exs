defmodule Situ.Conformance.Datasets.Contents do
  # Sessions and partitions are created, appended, renamed, moved and saved. Checks the contents
  # of the dataset and their spans.
  import Situ.Conformance.Case
  alias Situ.{Dataset, Interval, Message, Store}
  alias Situ.Conformance.Datasets.Steps
  alias Situ.Dataset.{OpenSession, Server, Session, Summary}

  def run(op, params, case, root) do
    case made(op, params, root) do
      {:error, %Situ.Error{} = error} ->
        outputs(case, {:error, error})

      {:ok, state} when is_map_key(case, "expect_error") ->
        {:fail, {:error, case["expect_error"]}, state}

      {:ok, state} ->
        expected(case["expect"], state)
    end
  end

  # The state contains the dataset, the changes of the last step, and the spans of the stores by
  # session and partition.
  defp made("dataset.append", params, root) do
    with {:ok, first} <- sessions(params["first"], params, root),
         {:ok, second} <- sessions(params["second"], params, root),
         {:ok, both} <- Dataset.append_sessions(first, second),
         do: {:ok, %{dataset: both, changes: Server.diff_datasets(first, both)}}
  end

  defp made("dataset.move", params, root) do
    here = Path.join(root, "here")
    there = Path.join([root, "there", "sub-folder"])

    with {:ok, dataset} <- sessions(params["sessions"] || ["Session_0"], params, here),
         {:ok, saved} <- Dataset.save_as(dataset, Path.join(here, "dataset.json")) do
      File.mkdir_p!(Path.dirname(there))
      File.rename!(here, there)

      with {:ok, moved} <- Dataset.load(Path.join(there, Path.basename(saved.file))),
           do: {:ok, %{dataset: moved}}
    end
  end

  defp made(op, %{"partitions" => _} = params, root) when op in ["session", "session.importer"] do
    with {:ok, dataset} <- sessions(["Session_0"], %{}, root, false),
         {:ok, dataset} <- partitions(dataset, params["partitions"], root),
         do: {:ok, %{dataset: dataset, spec: params["stream"]}}
  end

  defp made(op, params, root) do
    autosave? = params["autosave"] == true or op == "dataset.autosave"
    names = params["sessions"] || if(params["steps"], do: [], else: ["Session_0"])

    with {:ok, new} <-
           Dataset.new("Untitled Dataset",
             file: Path.join(root, "dataset.json"),
             autosave: autosave?
           ),
         {:ok, dataset} <- add(new, names, params["stores"], root, true),
         {:ok, [stepped | _] = states} <- Steps.run(dataset, params, &store(nil, &1, root)) do
      changes = Server.diff_datasets(dataset, stepped)
      {:ok, %{dataset: stepped, states: Enum.reverse(states), changes: changes, empty: new}}
    end
  end

  defp sessions(names, params, root, stores? \\ true) do
    with {:ok, dataset} <- Dataset.new(), do: add(dataset, names, params["stores"], root, stores?)
  end

  defp add(dataset, names, stores, root, stores?) do
    names
    |> Enum.with_index()
    |> Enum.reduce_while({:ok, dataset}, fn {name, i}, {:ok, dataset} ->
      store = if stores?, do: store(stores, i, root)

      case session(dataset, name, store) do
        {:ok, dataset} -> {:cont, {:ok, dataset}}
        error -> {:halt, error}
      end
    end)
  end

  defp session(dataset, name, nil), do: Dataset.add_session(dataset, name)

  defp session(dataset, name, path),
    do: Dataset.add_recording(dataset, path, session: name, partition: "Partition_0")

  defp partitions(dataset, names, root) do
    names
    |> Enum.with_index()
    |> Enum.reduce_while({:ok, dataset}, fn {name, i}, {:ok, dataset} ->
      case Dataset.add_partition(dataset, "Session_0", name, store(nil, i, root)) do
        {:ok, dataset} -> {:cont, {:ok, dataset}}
        error -> {:halt, error}
      end
    end)
  end

  # One stream Root with 0..9, one tick apart. Each store starts an hour after the previous one.
  def store(names, i, root) do
    name = (names || []) |> Enum.at(i, "Store#{i}") |> String.split(" ") |> hd()
    {:ok, writer} = Store.Writer.create(name, root)
    {:ok, stream} = Store.Writer.stream(writer, "Root", type: :integer)
    start = Situ.Time.h(i + System.unique_integer([:positive, :monotonic]))

    messages =
      for n <- 0..9 do
        time = start + ticks(n)
        %Message{data: n, originating_time: time, creation_time: time, sequence_id: n}
      end

    {:ok, _} = Store.Writer.append(stream, messages)
    :ok = Store.Writer.close(writer)
    writer.path
  end

  # A list of truth values is about the dataset after each step, and an object about its file.
  defp expected(expect, state) do
    Enum.find_value(expect, :pass, fn {key, wanted} ->
      case part(key, wanted, state) do
        :pass -> nil
        other -> other
      end
    end)
  end

  defp part(key, [first | _] = wanted, %{states: states} = state) when is_boolean(first),
    do: verdict(wanted, Enum.map(states, &got(key, %{state | dataset: &1})))

  defp part(_key, %{} = facts, state), do: expected(facts, reloaded(state))
  defp part(key, wanted, state), do: verdict(wanted(key, wanted, state), got(key, state))

  # An interval as text: "left of A .. right of B", "same" (as the session's interval), "empty".
  defp wanted(key, words, state) when is_binary(words) do
    if String.ends_with?(key, "interval"), do: span(words, state), else: words
  end

  defp wanted(_key, value, _state), do: value

  # The state as another program reads it from the file.
  defp reloaded(state) do
    {:ok, saved} = Dataset.load(state.dataset.file)
    %{state | dataset: saved}
  end

  defp span("empty", _state), do: :empty
  defp span("same", state), do: got("session_interval", state)

  defp span(words, state) do
    [_, left, right] = Regex.run(~r/\Aleft of (\S+) \.\. right of (\S+)\z/, words)
    {interval(left, state).left, interval(right, state).right}
  end

  defp interval(name, %{dataset: dataset}) do
    found =
      for session <- dataset.sessions,
          {own, summary} <- [{session.name, Session.summary(session)} | members(session)],
          own == name,
          do: summary.originating

    hd(found)
  end

  defp members(session) do
    for partition <- session.partitions do
      {:ok, summary} = Dataset.Partition.summary(partition)
      {partition.name, summary}
    end
  end

  defp got("sessions", state), do: Enum.map(state.dataset.sessions, & &1.name)
  defp got("partitions", state), do: Enum.map(first(state).partitions, & &1.name)
  defp got("empty_dataset_interval", state), do: plain_span(Dataset.summary(state.empty))
  defp got("session_interval", state), do: state |> first() |> Session.summary() |> plain_span()
  defp got("interval", state), do: got("dataset_interval", state)
  defp got("dataset_interval", state), do: plain_span(Dataset.summary(state.dataset))
  defp got("session_changed", state), do: Enum.any?(state.changes, &match?({:session, _}, &1))
  defp got("dataset_changed", state), do: :dataset in state.changes
  defp got("name", state), do: state.dataset.name
  defp got("session_count", state), do: length(state.dataset.sessions)
  defp got("unsaved" <> _, state), do: state.dataset.unsaved?
  defp got("has_unsaved" <> _, state), do: state.dataset.unsaved?

  defp got("streams_readable", state) do
    Enum.all?(state.dataset.sessions, fn session ->
      open = OpenSession.open(session)
      {:ok, messages} = OpenSession.messages(open, "Root")
      open.troubles == [] and Enum.map(messages, & &1.data) == Enum.to_list(0..9)
    end)
  end

  # "saved_sessions", "reloaded_name": the same fact about the dataset in its file.
  defp got(key, state)
       when key not in ["saved", "saved_equals_memory"] and is_map_key(state, :states) do
    case Regex.run(~r/^(?:saved|reloaded|loaded|file)_(.+)$/, key) do
      [_, fact] -> got(fact, reloaded(state))
      nil -> "no meaning known for #{key}"
    end
  end

  defp got("saved" <> _, state) do
    with {:ok, saved} <- Dataset.load(state.dataset.file),
         do: saved.sessions == state.dataset.sessions and saved.name == state.dataset.name
  end

  defp got("stream" <> _, state) do
    with {:ok, {partition, _, stream}} <-
           OpenSession.fetch_stream(OpenSession.open(first(state)), state.spec),
         do: "[#{partition}]:#{stream}"
  end

  defp got(key, _state), do: "no meaning known for #{key}"

  defp first(state), do: hd(state.dataset.sessions)

  defp plain_span(%Summary{originating: interval}) do
    if Interval.empty?(interval), do: :empty, else: {interval.left, interval.right}
  end
end
