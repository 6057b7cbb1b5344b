for file <- ~w(text formula case facts inputs),
    do: Code.require_file("#{file}.exs", __DIR__)

defmodule Situ.Conformance do
  # Runs conformance files: JSON with an area, conventions and cases. There is one module per
  # area, listed in `@areas`; its `check/1` returns `:pass`, `{:fail, expected, got}` or
  # `{:not_applicable, reason}`.
  # The file name contains the area ("fuse.json", "situ_fuse.json"). If it does not, the area of
  # each case follows from its operation.

  alias Situ.Conformance.Text.UnknownForm

  @patience_ms 90_000
  @folder Path.join(__DIR__, "areas")

  # Maps a name to the module of areas/NAME.exs, or to the reason why there is none.
  @areas %{
    "intervals" => Situ.Conformance.Intervals,
    "interpolators" => Situ.Conformance.Interpolators,
    "fuse" => Situ.Conformance.Fuse,
    "zip_merge" => Situ.Conformance.ZipMerge,
    "windows" => Situ.Conformance.Windows,
    "sampling" => Situ.Conformance.Sampling,
    "operators" => Situ.Conformance.Operators,
    "statistics" => Situ.Conformance.Statistics,
    "parallel" => Situ.Conformance.Parallel,
    "generators" => Situ.Conformance.Generators,
    "emitter" => Situ.Conformance.Emitter,
    "delivery_policies" => Situ.Conformance.DeliveryPolicies,
    "pipeline_lifecycle" => Situ.Conformance.PipelineLifecycle,
    "store" => Situ.Conformance.Store,
    "datasets" => Situ.Conformance.Datasets,
    "interop" => Situ.Conformance.Interop,
    "serialization" => "Situ writes no other system's object graphs",
    "memory_sharing" => "terms are immutable and collected: there is nothing to share by hand",
    "time" =>
      "the counter is held against the system's time by rules of its own (Situ.Clock.Wall)"
  }

  # The area of an operation. The first match applies.
  @operations [
    {~r/^interpolator\./, "interpolators"},
    {~r/^(interval|endpoint|index_|time_plus)/, "intervals"},
    {~r/^(fuse|join|pair)/, "fuse"},
    {~r/^(zip|merge)/, "zip_merge"},
    {~r/^window/, "windows"},
    {~r/^(sample|interpolate)/, "sampling"},
    {~r/\.(running|of_list|history)$|^(delta|abs|log)/, "statistics"},
    {~r/^parallel/, "parallel"},
    {~r/^(sequence|range|repeat|return|once|timer)/, "generators"},
    {~r/^(deliver|post|subscribe)$/, "emitter"},
    {~r/^delivery/, "delivery_policies"},
    {~r/^(completion|dispose|events|run|error|order|clock|progress|finali)/,
     "pipeline_lifecycle"},
    {~r/^(add_component|subpipeline$|composite|connector)/, "pipeline_lifecycle"},
    {~r/^store/, "store"},
    {~r/^(dataset|session|json_store)/, "datasets"},
    {~r/^(format|file_|zeromq|datagram)/, "interop"}
  ]

  # With `--mutants`, every expectation is also changed, and the case must then fail.
  def main(["--mutants" | paths]) do
    survivors =
      for file <- Enum.flat_map(paths, &found/1),
          {id, how} <- Situ.Conformance.Mutation.survivors(file, 12),
          do: IO.puts("SURVIVED #{Path.basename(file, ".json")} #{id} #{how}")

    IO.puts("#{length(survivors)} changed expectations went unnoticed")
    if survivors == [], do: 0, else: 1
  end

  def main(paths) do
    case Enum.flat_map(paths, &found/1) do
      [] ->
        IO.puts(:stderr, "conformance: no *.json in #{Enum.join(paths, ", ")}")
        IO.puts(:stderr, "  Fix: name a folder of conformance files, or a file")
        2

      files ->
        files |> Enum.map(&run_file/1) |> report()
    end
  end

  defp found(path) do
    if File.regular?(path), do: [path], else: Path.wildcard(Path.join(path, "*.json"))
  end

  # Returns the cases of one file with their verdicts: `[{id, verdict}]`.
  def verdicts(file) do
    case read(file) do
      {:ok, cases} -> Enum.map(cases, &{id(&1), verdict(area(file), &1)})
      {:error, reason} -> [{Path.basename(file), {:fail, "a readable conformance file", reason}}]
    end
  end

  # Returns the cases of one file, each with its verdict and its duration in us.
  def timed_verdicts(file) do
    {:ok, cases} = read(file)

    for case <- cases do
      {us, verdict} = :timer.tc(fn -> verdict(area(file), case) end)
      {case, verdict, us}
    end
  end

  def files, do: Path.wildcard(Path.expand("../../priv/conformance/*.json", __DIR__))

  # Returns the area in a file's name (the longest if there are several), or nil.
  def area(file) do
    name = Path.basename(file, ".json")

    @areas
    |> Map.keys()
    |> Enum.filter(&(name =~ ~r/(^|[^a-z])#{&1}($|[^a-z])/))
    |> Enum.max_by(&String.length/1, fn -> nil end)
  end

  defp run_file(file) do
    verdicts = verdicts(file)
    for {id, {:fail, expected, got}} <- verdicts, do: failure("FAIL", file, id, expected, got)
    for {id, {:quirk, expected, got}} <- verdicts, do: failure("QUIRK", file, id, expected, got)
    {Path.basename(file, ".json"), verdicts}
  end

  defp failure(how, file, id, expected, got) do
    IO.puts("#{how} #{Path.basename(file, ".json")} #{id}")
    IO.puts("  expected #{shown(expected)}")
    IO.puts("  got      #{shown(got)}")
  end

  defp shown(text) when is_binary(text), do: text
  defp shown(term), do: inspect(term, charlists: :as_lists, limit: 60, printable_limit: 500)

  defp report(areas) do
    total = Enum.reduce(areas, {0, 0, 0}, &report_area/2)
    {passed, failed, skipped} = total
    IO.puts("#{passed} passed, #{failed} failed, #{skipped} not applicable")
    if failed == 0, do: 0, else: 1
  end

  defp report_area({area, verdicts}, {passed, failed, skipped}) do
    p = Enum.count(verdicts, &match?({_, :pass}, &1))
    f = Enum.count(verdicts, &match?({_, {:fail, _, _}}, &1))
    reasons = for {_, verdict} <- verdicts, reason = reason(verdict), do: reason
    n = length(reasons)
    why = reasons |> Enum.uniq() |> Enum.join("; ")
    note = if n > 0, do: " (#{why})", else: ""

    IO.puts(
      "#{String.pad_trailing(area, 20)} #{p} passed, #{f} failed, #{n} not applicable#{note}"
    )

    {passed + p, failed + f, skipped + n}
  end

  defp reason({:not_applicable, reason}), do: reason
  defp reason({:quirk, _, _}), do: "a quirk of the reference that Situ does not share"
  defp reason(_verdict), do: nil

  defp read(file) do
    with {:ok, text} <- File.read(file),
         {:ok, %{"cases" => cases}} when is_list(cases) <- Situ.JSON.decode(text),
         {:ok, {ordered}} <- Situ.JSON.decode(text, objects: :pairs),
         {"cases", ordered} <- List.keyfind(ordered, "cases", 0) do
      {:ok, Enum.zip_with(cases, ordered, &with_order/2)}
    else
      {:ok, _} -> {:error, "it has no list of \"cases\""}
      {:error, :bad_json} -> {:error, "it is not JSON"}
      {:error, reason} -> {:error, "it cannot be read: #{:file.format_error(reason)}"}
    end
  end

  # If the order of an object's members is part of the case, it is read from this text.
  defp with_order(%{"op" => "format." <> _} = case, ordered),
    do: Map.put(case, "ordered", ordered)

  defp with_order(case, _ordered), do: case

  defp id(%{"id" => id}) when is_binary(id), do: id
  defp id(_case), do: "(no id)"

  # A case is a map with an operation and its expected results; parameters and inputs are
  # optional.
  # Returns the verdict on one case.
  def verdict(area, %{"op" => op} = case) when is_binary(op) do
    case = case |> fill("params", %{}) |> fill("inputs", [])

    cond do
      not (Map.has_key?(case, "expect") or Map.has_key?(case, "expect_error")) ->
        {:fail, "a case with \"expect\" or \"expect_error\"", "neither"}

      not is_map(case["params"]) or not is_list(case["inputs"]) ->
        {:fail, "params as an object, inputs as a list", Map.take(case, ["params", "inputs"])}

      true ->
        check(area_module(area || area_of(op), op), case)
    end
  end

  def verdict(_area, other), do: {:fail, "a case with an \"op\"", other}

  defp fill(case, key, default),
    do: if(case[key] == nil, do: Map.put(case, key, default), else: case)

  defp area_of(op),
    do: Enum.find_value(@operations, "operators", fn {re, area} -> op =~ re && area end)

  defp area_module(area, op) do
    path = Path.join(@folder, area <> ".exs")

    case Map.fetch!(@areas, area) do
      reason when is_binary(reason) ->
        {:not_applicable, reason}

      module ->
        Code.require_file(path)

        if known?(module, op),
          do: module,
          else: {:not_applicable, "no check for the operation #{op}"}
    end
  end

  defp known?(module, op),
    do: not function_exported?(module, :operation?, 1) or module.operation?(op)

  defp check({:not_applicable, _} = verdict, _case), do: verdict

  # A quirk of the reference. Most of these cases list the right result, which is required as
  # usual. If the listed result is the reference's own ("a better system does otherwise"), a
  # different result of Situ is shown but does not count as a failure.
  defp check(module, %{"known_quirk" => true} = case) do
    if right_answer?(case), do: checked(module, case), else: quirk(module, case)
  end

  defp check(module, case), do: checked(module, case)

  @right ~r/(listed|expected|right) (answer|result|value|output)s?\b|sensible/i
  @theirs ~r/better (system|implementation|one)|reference[- ]behaviou?r/i

  defp right_answer?(case) do
    told = "#{case["id"]} #{case["notes"]}"
    told =~ @right or not (told =~ @theirs)
  end

  defp quirk(module, case) do
    case checked(module, case) do
      {:fail, expected, got} -> {:quirk, expected, got}
      verdict -> verdict
    end
  end

  # Each case runs in a process of its own, so that none sees the messages of another, and a case
  # that does not end fails.
  defp checked(module, case) do
    if Situ.Runtime.simulated?(), do: judge(module, case), else: checked_alone(module, case)
  end

  defp checked_alone(module, case) do
    task = Task.async(fn -> judge(module, case) end)

    case Task.yield(task, @patience_ms) || Task.shutdown(task, :brutal_kill) do
      {:ok, verdict} -> verdict
      _ -> {:fail, expectation(case), "no result within #{div(@patience_ms, 1_000)} s"}
    end
  end

  defp judge(module, case) do
    case module.check(case) do
      {:fail, expected, got} -> {:fail, expected, unknown_form(got) || got}
      verdict -> verdict
    end
  rescue
    error ->
      unreadable_or_expected(case, error, __STACKTRACE__)
  catch
    kind, reason -> {:fail, expectation(case), Exception.format_banner(kind, reason)}
  end

  # An error during the set-up of a case may be the error that the case expects.
  defp unreadable_or_expected(%{"expect_error" => name} = case, error, stack) do
    if Situ.Conformance.Case.error_fits?(name, error),
      do: :pass,
      else: unreadable(case, error, stack)
  end

  defp unreadable_or_expected(case, error, stack), do: unreadable(case, error, stack)

  # The message of a part that no rule reads, also as the cause of a pipeline's error.
  defp unknown_form(%UnknownForm{message: message}), do: message
  defp unknown_form({:error, error}), do: unknown_form(error)

  defp unknown_form(%Situ.Error{meta: meta}),
    do: Enum.find_value([:reason, :cause, :exception], &unknown_form(meta[&1]))

  defp unknown_form(_other), do: nil

  defp unreadable(case, %UnknownForm{message: message}, _stack),
    do: {:fail, expectation(case), message}

  defp unreadable(case, %Situ.Error{} = error, _stack),
    do: {:fail, expectation(case), unknown_form(error) || Exception.message(error)}

  # No clause of an area fits the operation with these parameters and inputs.
  defp unreadable(case, %FunctionClauseError{function: :check}, _stack) do
    {:fail, expectation(case),
     "no rule reads #{case["op"]} with the parameters #{inspect(Map.keys(case["params"]))}, " <>
       "#{length(case["inputs"])} inputs and the expectation #{inspect(keys(expectation(case)))}"}
  end

  defp unreadable(case, error, stack) do
    {:fail, expectation(case),
     "this form of #{case["op"]} cannot be read: " <> first_lines(error, stack)}
  end

  defp first_lines(error, stack),
    do:
      :error
      |> Exception.format(error, stack)
      |> String.split("\n")
      |> Enum.take(4)
      |> Enum.join("\n")

  defp keys(%{} = expectation), do: Map.keys(expectation)
  defp keys(_expectation), do: "as a value"

  defp expectation(case), do: Map.get(case, "expect") || {:error, case["expect_error"]}
end

Code.require_file("mutation.exs", __DIR__)
