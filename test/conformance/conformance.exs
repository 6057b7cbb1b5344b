Code.require_file("formula.exs", __DIR__)

defmodule Situ.Conformance do
  # Runs conformance files: JSON with an area, conventions and cases. There is one module per
  # area, listed in `@areas`; its `check/1` returns `:pass`, `{:fail, expected, got}` or
  # `{:not_applicable, reason}`.
  # The file name contains the area ("fuse.json", "situ_fuse.json"). If it does not, the area of
  # each case follows from its operation.

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

  @right ~r/(listed|expected|right) (answer|result|value|output)s?\b|must |no matter|for every|sensible/i
  @theirs ~r/better (system|implementation)|reference[- ]behaviou?r/i

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

  defp checked(module, case) do
    module.check(case)
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

  defp unreadable(case, %Situ.Error{} = error, _stack),
    do: {:fail, expectation(case), Exception.message(error)}

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

  defp expectation(case), do: Map.get(case, "expect") || {:error, case["expect_error"]}
end

defmodule Situ.Conformance.Case do
  # Shared functions of the areas: times, values with their tolerance, and verdicts.

  @tick 100
  @ms 1_000_000

  # Special numbers are strings in the files and atoms in Situ.
  def value("NaN"), do: :nan
  def value("Infinity"), do: :infinity
  def value("-Infinity"), do: :neg_infinity
  def value(list) when is_list(list), do: Enum.map(list, &value/1)
  def value(map) when is_map(map), do: Map.new(map, fn {k, v} -> {k, value(v)} end)
  def value(other), do: other

  def time(%{"t_ticks" => t}), do: t * @tick
  def time(%{"t_us" => t}), do: round(t * 1_000)
  def time(%{"t_ms" => t}), do: round(t * @ms)
  def time(%{"t_s" => t}), do: round(t * 1_000 * @ms)

  def ticks(n), do: n * @tick
  def ms(n), do: round(n * @ms)

  # `[{time, value}]` for a list of messages or an expectation.
  def timed(messages), do: Enum.map(messages, &{time(&1), value(&1["v"])})

  def messages(messages),
    do: for({t, v} <- timed(messages), do: %Situ.Message{originating_time: t, data: v})

  # Situ returns tuples for the files' arrays.
  def plain(tuple) when is_tuple(tuple), do: tuple |> Tuple.to_list() |> plain()
  def plain(list) when is_list(list), do: Enum.map(list, &plain/1)
  def plain(%_{} = struct), do: struct
  def plain(map) when is_map(map), do: Map.new(map, fn {k, v} -> {k, plain(v)} end)
  def plain(other), do: other

  def same?(expected, got, tolerance \\ 1.0e-12)
  def same?(a, b, _) when is_integer(a) and is_integer(b), do: a == b

  def same?(a, b, tolerance) when is_number(a) and is_number(b),
    do: abs(a - b) <= tolerance * max(1.0, max(abs(a), abs(b)))

  def same?(a, b, tolerance) when is_list(a) and is_list(b),
    do:
      length(a) == length(b) and
        Enum.all?(Enum.zip(a, b), fn {x, y} -> same?(x, y, tolerance) end)

  def same?({t, a}, {u, b}, tolerance), do: t == u and same?(a, b, tolerance)

  def same?(a, b, tolerance) when is_map(a) and is_map(b),
    do: Map.keys(a) == Map.keys(b) and Enum.all?(a, fn {k, v} -> same?(v, b[k], tolerance) end)

  def same?(a, b, _), do: a == b

  def verdict(expected, got, tolerance \\ 1.0e-12) do
    if same?(expected, got, tolerance), do: :pass, else: {:fail, expected, got}
  end

  # Compares every part of an expectation with the result. A part without a check is a failure.
  def all(case, got, tolerance \\ 1.0e-12)

  def all(%{"expect" => %{} = expect}, got, tolerance) do
    case Map.keys(expect) -- Map.keys(got) do
      [] ->
        verdict(value(expect), got |> Map.take(Map.keys(expect)) |> plain(), tolerance)

      unread ->
        {:fail, expect, "nothing checks #{Enum.map_join(unread, ", ", &inspect/1)}"}
    end
  end

  def all(%{"expect" => expect}, got, _tolerance), do: {:fail, expect, got}

  # A property as text: returns the text itself if one of the readings matches it and holds.
  # `readings`: `{regex, holds?}`, or a function of the regex captures. The regex must match the
  # entire text.
  def told(text, readings) when is_binary(text) do
    Enum.find_value(readings, {:unread, text}, fn {regex, holds?} ->
      case Regex.run(regex, text) do
        [^text | captured] -> if holds(holds?, captured), do: text, else: {:not_so, text}
        _ -> nil
      end
    end)
  end

  def told(other, _readings), do: {:unread, other}

  # The same for texts that vary: the text must contain `regex`, and consist of words only.
  def meant(text, regex, holds?) when is_binary(text) do
    cond do
      not (text =~ regex) or text =~ "_" -> {:unread, text}
      holds? -> text
      true -> {:not_so, text}
    end
  end

  def meant(other, _regex, _holds?), do: {:unread, other}

  defp holds(fun, captured) when is_function(fun, 1), do: fun.(captured)
  defp holds(holds?, _captured), do: holds?

  # Compares the outputs `[{time, value}]` of an operator with the case.
  def outputs(case, result, tolerance \\ 1.0e-12)

  def outputs(%{"expect_error" => code}, {:error, error}, _tolerance) do
    if error_fits?(code, error), do: :pass, else: {:fail, {:error, code}, error}
  end

  def outputs(%{"expect_error" => code}, {:ok, got}, _tolerance), do: {:fail, {:error, code}, got}
  def outputs(case, {:error, error}, _tolerance), do: {:fail, case["expect"], error}

  def outputs(%{"expect" => expect}, {:ok, got}, tolerance) when is_list(expect),
    do: verdict(timed(expect), Enum.map(got, fn {t, v} -> {t, plain(v)} end), tolerance)

  def outputs(%{"expect" => %{"multiset" => values}}, {:ok, got}, _tolerance),
    do: verdict(Enum.sort(value(values)), got |> Enum.map(&plain(elem(&1, 1))) |> Enum.sort())

  # Maps error names in the files to Situ's codes.
  @codes %{
    "argument_error" => [ArgumentError],
    "not_supported" => [:not_supported],
    "invalid_operation" => [
      :empty_list,
      :wrong_length,
      :already_connected,
      :pipeline_running,
      :duplicate_name,
      :ambiguous_stream
    ],
    "empty_sequence" => [:empty_list],
    "window_before_previous_obsolete" => [:window_before_obsolete],
    "window_before_obsolete_time" => [:window_before_obsolete],
    "before_previous_obsolete_time" => [:window_before_obsolete],
    "negative_interval" => [:window_negative],
    "interval_not_finite" => [:window_not_finite],
    "division_by_zero" => [ArithmeticError],
    "validator_error" => [ArgumentError],
    "originating_times_not_increasing" => [:time_not_increasing],
    "originating_time_not_strictly_increasing" => [:time_not_increasing]
  }

  # An aggregate error contains all errors of the pipeline, one of which must have the expected
  # name.
  def error_fits?("aggregate_pipeline_error(" <> name, error),
    do: error |> errors() |> Enum.any?(&error_fits?(String.replace_suffix(name, ")", ""), &1))

  def error_fits?(name, error) do
    code = code(error)
    code in Map.get(@codes, name, []) or to_string(code) == name
  end

  defp errors(%Situ.Error{meta: %{errors: [_ | _] = errors}}), do: errors
  defp errors(error), do: [error]

  # The innermost cause, since a pipeline wraps the errors of its components.
  defp code(%Situ.Error{meta: %{reason: %_{} = inner}}), do: code(inner)
  defp code(%Situ.Error{meta: %{cause: %_{} = inner}}), do: code(inner)
  defp code(%Situ.Error{meta: %{exception: %_{} = inner}}), do: code(inner)
  defp code(%Situ.Error{code: code}), do: code
  defp code(%module{}), do: module
  defp code(other), do: other

  def attempt(fun) do
    {:ok, fun.()}
  rescue
    error -> {:error, error}
  end
end

defmodule Situ.Conformance.Run do
  # Runs the inputs of a case through a pipeline.
  import Situ.Conformance.Case

  @long_ago_is_over 1_000_000_000_000_000

  # `build.(streams)` receives the input streams in the order of the case. Inputs that stay open,
  # or whose order of arrival matters, are fed singly into a waiting pipeline. The others run as
  # fast as possible.
  def inputs(case, build) do
    if Enum.any?(case["inputs"], &(&1["keep_open"] || &1["arrives_after_ms"])),
      do: in_turn(case["inputs"], build),
      else: at_once(case["inputs"], build)
  end

  def at_once(inputs, build) do
    named = for {input, i} <- Enum.with_index(inputs), do: {i, timed(input["messages"])}
    # The pipeline starts at 0, or with the first message if that is earlier.
    start = named |> Enum.flat_map(&elem(&1, 1)) |> Enum.reduce(0, &min(elem(&1, 0), &2))
    opts = [pipeline: [replay: [interval: {start, :unbounded}]]]
    guarded(fn -> Situ.Test.run(Map.new(named), &build.(in_order(&1)), opts) end)
  end

  # Sends entire inputs in sequence, the one that arrives first before the others.
  def in_turn(inputs, build) do
    indexed = Enum.with_index(inputs)

    waiting(inputs, build, @long_ago_is_over, fn test ->
      for {input, i} <- Enum.sort_by(indexed, fn {input, _} -> input["arrives_after_ms"] || 0 end) do
        Situ.Test.feed(test, i, timed(input["messages"]))
        unless input["keep_open"], do: Situ.Test.close(test, i)
      end

      # Outputs with clock times are emitted when the clock advances.
      Situ.Test.advance(test, ms(1))
    end)
  end

  # Sends the messages in the order of time, which is their order of arrival if none is late.
  def by_time(inputs, build) do
    all =
      for {input, i} <- Enum.with_index(inputs),
          {time, value} <- timed(input["messages"]),
          do: {time, i, value}

    waiting(inputs, build, @long_ago_is_over, fn test ->
      for {time, i, value} <- Enum.sort_by(all, fn {time, i, _} -> {time, i} end),
          do: Situ.Test.feed(test, i, {time, value})
    end)
  end

  # A pipeline with a clock that starts at `start`; `steps` advances it and feeds the pipeline.
  def waiting(inputs, build, start, steps) do
    guarded(fn ->
      keys = Enum.to_list(0..(length(inputs) - 1)//1)
      test = Situ.Test.start(keys, fn streams -> build.(in_order(streams)) end, start: start)
      steps.(test)
      outputs = Situ.Test.outputs(test)

      case Situ.Test.stop(test) do
        {:ok, _report} -> {:ok, outputs}
        {:error, error} -> {:error, error}
      end
    end)
  end

  def guarded(fun) do
    fun.()
  rescue
    error -> {:error, error}
  end

  defp in_order(streams), do: streams |> Enum.sort() |> Enum.map(&elem(&1, 1))
end

Code.require_file("mutation.exs", __DIR__)
