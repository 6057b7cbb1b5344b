defmodule Situ.Conformance.Datasets.Derived do
  # A pipeline over a session writes a new partition: its values, their times, and what a
  # cancelled run leaves.
  import Situ.Conformance.Case, only: [all: 2, error_fits?: 2, meant: 3]
  alias Situ.Conformance.Datasets.Contents
  alias Situ.Conformance.Formula
  alias Situ.{Dataset, Store}
  alias Situ.Dataset.{Importer, OpenSession}

  @cancelled ~r/^(aggregate_pipeline_error\()?(operation_)?cancell?ed\)?$/

  def run(_op, params, case, root) do
    names = params["partitions"] || ["Partition_0"]
    {:ok, dataset} = Dataset.new()
    {:ok, dataset} = Dataset.add_session(dataset, "Session_0")

    dataset =
      for {name, i} <- Enum.with_index(names), reduce: dataset do
        dataset ->
          dataset
          |> Dataset.add_partition("Session_0", name, Contents.store(nil, i, root))
          |> elem(1)
      end

    output = params["name"] || params["new_partition"] || params["output"] || "Derived"
    stream = params["stream"] || "DerivedStream"

    dataset
    |> Dataset.derive(compute(params, stream), options(params, output, root))
    |> outcome(case, %{output: output, stream: stream, root: root, before: dataset})
  end

  defp compute(params, stream) do
    formula = Enum.find_value(~w(function transform compute derive), &params[&1]) || "v"
    fun = Formula.of_one(formula)
    pause = if params["cancel_after_ms"], do: params["cancel_after_ms"], else: 0

    fn _p, importer, exporter ->
      importer
      |> Importer.stream("Root")
      |> Situ.map(fn v ->
        Process.sleep(pause)
        fun.(v)
      end)
      |> Store.write(exporter, stream)
    end
  end

  defp options(params, output, root) do
    cancel = params["cancel_after_ms"]
    until = System.monotonic_time(:millisecond) + (cancel || 0)
    options = [output: output, path: root, overwrite: params["overwrite"] == true]
    options = if store = params["store"], do: [store: store] ++ options, else: options

    if cancel,
      do: [cancel: fn -> System.monotonic_time(:millisecond) >= until end] ++ options,
      else: options
  end

  defp outcome({:error, error}, %{"expect_error" => name}, _at),
    do: if(error_fits?(name, error), do: :pass, else: {:fail, {:error, name}, error})

  defp outcome({:error, error}, case, _at), do: {:fail, case["expect"], error}

  defp outcome({:ok, dataset, report}, %{"expect_error" => name} = case, at) do
    cond do
      not (report.cancelled? and name =~ @cancelled) ->
        {:fail, {:error, name}, report}

      case["expect"] == nil ->
        facts(%{"expect" => %{"partitions" => names(at.before)}}, dataset, at)

      true ->
        facts(case, dataset, at)
    end
  end

  defp outcome({:ok, dataset, _report}, case, at), do: facts(case, dataset, at)

  defp facts(%{"expect" => expect}, dataset, at) do
    [session] = dataset.sessions
    open = OpenSession.open(session)
    original = messages(open, "Root")
    derived = if at.output in names(dataset), do: messages(open, at.stream), else: []
    times = fn messages -> Enum.map(messages, & &1.originating_time) end
    same? = derived != [] and times.(original) == times.(derived)
    values = Enum.map(derived, & &1.data)

    all(%{"expect" => expect}, %{
      "partitions" => names(dataset),
      "values" => values,
      "derived_values" => values,
      "original_values" => Enum.map(original, & &1.data),
      "count" => length(derived),
      "times" => meant(expect["times"], ~r/same|equal|unchanged|identical/, same?),
      "derived_times" =>
        meant(expect["derived_times"], ~r/same|equal|unchanged|identical/, same?),
      "derived_partition_exists" => at.output in names(dataset),
      "derived_store_exists" => derived != [],
      "original_store_exists" => original != []
    })
  end

  defp names(%{sessions: [session]}), do: Enum.map(session.partitions, & &1.name)

  defp messages(open, stream) do
    case OpenSession.messages(open, stream) do
      {:ok, messages} -> Enum.to_list(messages)
      {:error, _error} -> []
    end
  end
end
