defmodule Situ.Conformance.Datasets.Steps do
  # Changes a dataset step by step. A step is a sentence: "rename the dataset to A", "add an empty
  # session B", "add a session from a store", "rename the session B to C", "remove the session C",
  # "add a partition D to the session C", "save". Without names, it is about the first session.
  alias Situ.Conformance.Text
  alias Situ.Dataset

  # Returns the states after each step, the newest first. `store` makes the n-th recording.
  def run(dataset, params, store) do
    steps = params["steps"] || List.wrap(params["step"])

    steps
    |> Enum.with_index(100)
    |> Enum.reduce_while({:ok, [dataset]}, fn {text, n}, {:ok, [dataset | _] = states} ->
      case step(dataset, text, fn -> store.(n) end) do
        {:ok, dataset} -> {:cont, {:ok, [dataset | states]}}
        error -> {:halt, error}
      end
    end)
    |> without_first(steps)
  end

  # The state before the first step is a state only if there is no step.
  defp without_first({:ok, states}, [_ | _]), do: {:ok, Enum.drop(states, -1)}
  defp without_first(result, _steps), do: result

  @rules [
    {~r/^save(?: as)?(?: it| the dataset)?$/, :save},
    {~r/^(?:rename|name) the dataset(?: to (\S+))?$|^set the name(?: to (\S+))?$/, :rename},
    {~r/^rename (?:a|the) session(?: (\S+))?(?: to (\S+))?$/, :rename_session},
    {~r/^remove (?:a|the) session(?: (\S+))?$/, :remove_session},
    {~r/^add (?:a|an)(?: empty)? session(?: (?!from)(\S+))?$/, :add_session},
    {~r/^add a session(?: (?!from)(\S+))? from a store$/, :add_recording},
    {~r/^add a partition(?: (?!to)(\S+))?(?: to (?:a|the) session(?: (\S+))?)?$/, :add_partition}
  ]

  defp step(dataset, text, store) do
    Enum.find_value(@rules, fn {rule, action} ->
      with [_ | names] <- Regex.run(rule, text),
           do: act(action, dataset, Enum.map(names, &if(&1 == "", do: nil, else: &1)), store)
    end) || Text.unknown!("a step of a dataset", text)
  end

  defp act(:save, dataset, _names, _store), do: Dataset.save(dataset)

  defp act(:rename, dataset, names, _store),
    do: Dataset.put_fields(dataset, name: Enum.find(names, "Renamed", & &1))

  defp act(:rename_session, dataset, names, _store) do
    old = Enum.at(names, 0) || first(dataset)
    Dataset.rename_session(dataset, old, Enum.at(names, 1) || old <> "_renamed")
  end

  defp act(:remove_session, dataset, names, _store),
    do: Dataset.remove_session(dataset, Enum.at(names, 0) || first(dataset))

  defp act(:add_session, dataset, names, _store),
    do: Dataset.add_session(dataset, Enum.at(names, 0) || "Session_new")

  defp act(:add_recording, dataset, names, store) do
    name = Enum.at(names, 0) || "Session_#{length(dataset.sessions)}"
    Dataset.add_recording(dataset, store.(), session: name, partition: "Partition_0")
  end

  defp act(:add_partition, dataset, names, store) do
    name = Enum.at(names, 0) || "Partition_new"
    Dataset.add_partition(dataset, Enum.at(names, 1) || first(dataset), name, store.())
  end

  defp first(%{sessions: [session | _]}), do: session.name
  defp first(_dataset), do: Text.unknown!("a session", "a dataset without sessions")
end
