defmodule Situ.Conformance do
  # Runs conformance files: JSON with an area, conventions and cases. One module per area, listed in `areas/0`; its
  # `check/1` answers `:pass`, `{:fail, expected, got}` or `{:not_applicable, reason}`.

  @folder Path.join(__DIR__, "areas")

  # File name -> module of areas/NAME.exs, or why there is none.
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
    "datasets" => "datasets are not part of Situ yet",
    "interop" => "wire formats of other systems are not part of Situ yet"
  }

  def main(folders) do
    case Enum.flat_map(folders, &Path.wildcard(Path.join(&1, "*.json"))) do
      [] ->
        IO.puts(:stderr, "conformance: no *.json in #{Enum.join(folders, ", ")}")
        2

      files ->
        files |> Enum.map(&run_file/1) |> report()
    end
  end

  # The cases of one file with their verdicts: `[{id, verdict}]`.
  def verdicts(file) do
    area = Path.basename(file, ".json")

    case read(file) do
      {:ok, cases} ->
        module = area_module(area)
        Enum.map(cases, &{&1["id"] || "(no id)", check(module, &1)})

      {:error, reason} ->
        [{area, {:fail, "a readable conformance file", reason}}]
    end
  end

  def files, do: Path.wildcard(Path.expand("../../priv/conformance/*.json", __DIR__))

  defp run_file(file) do
    verdicts = verdicts(file)
    for {id, {:fail, expected, got}} <- verdicts, do: failure(file, id, expected, got)
    {Path.basename(file, ".json"), verdicts}
  end

  defp failure(file, id, expected, got) do
    IO.puts("FAIL #{Path.basename(file, ".json")} #{id}")
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
    reasons = for {_, {:not_applicable, reason}} <- verdicts, do: reason
    n = length(reasons)
    why = reasons |> Enum.uniq() |> Enum.join("; ")
    note = if n > 0, do: " (#{why})", else: ""

    IO.puts(
      "#{String.pad_trailing(area, 20)} #{p} passed, #{f} failed, #{n} not applicable#{note}"
    )

    {passed + p, failed + f, skipped + n}
  end

  defp read(file) do
    with {:ok, text} <- File.read(file) do
      case Situ.JSON.decode(text) do
        {:ok, %{"cases" => cases}} when is_list(cases) -> {:ok, cases}
        {:ok, _} -> {:error, "no list of cases in #{file}"}
        {:error, :bad_json} -> {:error, "#{file} is not JSON"}
      end
    end
  end

  defp area_module(area) do
    path = Path.join(@folder, area <> ".exs")

    case Map.fetch(@areas, area) do
      {:ok, reason} when is_binary(reason) ->
        {:not_applicable, reason}

      {:ok, module} ->
        if File.exists?(path) do
          Code.require_file(path)
          module
        else
          {:not_applicable, "no checks for this area yet"}
        end

      :error ->
        {:not_applicable, "unknown area #{area}"}
    end
  end

  defp check({:not_applicable, _} = verdict, _case), do: verdict

  defp check(module, case) do
    module.check(case)
  rescue
    error -> {:fail, expectation(case), Exception.format(:error, error, __STACKTRACE__)}
  catch
    kind, reason -> {:fail, expectation(case), Exception.format_banner(kind, reason)}
  end

  defp expectation(case), do: Map.get(case, "expect") || {:error, case["expect_error"]}
end

defmodule Situ.Conformance.Case do
  # What the areas share: times, values with their tolerance, verdicts.

  @tick 100
  @ms 1_000_000

  # Special numbers are strings in the files, atoms in Situ.
  def value("NaN"), do: :nan
  def value("Infinity"), do: :infinity
  def value("-Infinity"), do: :neg_infinity
  def value(list) when is_list(list), do: Enum.map(list, &value/1)
  def value(map) when is_map(map), do: Map.new(map, fn {k, v} -> {k, value(v)} end)
  def value(other), do: other

  def time(%{"t_ticks" => t}), do: t * @tick
  def time(%{"t_ms" => t}), do: round(t * @ms)

  def ticks(n), do: n * @tick
  def ms(n), do: round(n * @ms)

  # `[{time, value}]` of a list of messages or an expectation.
  def timed(messages), do: Enum.map(messages, &{time(&1), value(&1["v"])})

  def messages(messages),
    do: for({t, v} <- timed(messages), do: %Situ.Message{originating_time: t, data: v})

  # Tuples come out where the files have arrays.
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

  # The outputs `[{time, value}]` of an operator against the case.
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

  # The files' names of errors, and Situ's codes.
  @codes %{
    "argument_error" => [ArgumentError],
    "not_supported" => [:not_supported],
    "invalid_operation" => [:empty_list],
    "obsolete_time_before_previous" => [:obsolete_time_before_previous],
    "originating_times_not_increasing" => [:time_not_increasing]
  }

  def error_fits?(name, error) do
    code = code(error)
    code in Map.get(@codes, name, []) or to_string(code) == name
  end

  # The innermost cause: a pipeline wraps the error of its component.
  defp code(%Situ.Error{meta: %{reason: %_{} = inner}}), do: code(inner)
  defp code(%Situ.Error{meta: %{cause: %_{} = inner}}), do: code(inner)
  defp code(%Situ.Error{code: code}), do: code
  defp code(%module{}), do: module
  defp code(other), do: other

  # A case that tells what the reference does against its own definition: met or not, it is no failure.
  def quirk({:fail, _expected, _got}),
    do: {:not_applicable, "a quirk of the reference that Situ does not share"}

  def quirk(verdict), do: verdict

  def attempt(fun) do
    {:ok, fun.()}
  rescue
    error -> {:error, error}
  end
end

defmodule Situ.Conformance.Run do
  # The inputs of a case through a pipeline.
  import Situ.Conformance.Case

  @long_ago_is_over 1_000_000_000_000_000

  # `build.(streams)`, the inputs' streams in the order of the case. Inputs whose arrival matters or which stay open are fed one
  # by one into a pipeline that waits; the others run as fast as they can.
  def inputs(case, build) do
    if Enum.any?(case["inputs"], &(&1["keep_open"] || &1["arrives_after_ms"])),
      do: in_turn(case["inputs"], build),
      else: at_once(case["inputs"], build)
  end

  def at_once(inputs, build) do
    named = for {input, i} <- Enum.with_index(inputs), do: {i, timed(input["messages"])}
    guarded(fn -> Situ.Test.run(Map.new(named), fn streams -> build.(in_order(streams)) end) end)
  end

  # Whole inputs after one another, the earliest arrival first.
  def in_turn(inputs, build) do
    indexed = Enum.with_index(inputs)

    waiting(inputs, build, @long_ago_is_over, fn test ->
      for {input, i} <- Enum.sort_by(indexed, fn {input, _} -> input["arrives_after_ms"] || 0 end) do
        Situ.Test.feed(test, i, timed(input["messages"]))
        unless input["keep_open"], do: Situ.Test.close(test, i)
      end

      # What an operator stamps with the clock comes out as the clock goes on.
      Situ.Test.advance(test, ms(1))
    end)
  end

  # Message by message in the order of time: as they arrive when nothing is late.
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

  # A pipeline by a clock that stands at `start`; `steps` moves it and feeds it.
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

  # Arithmetic of the files ("10*p + s", "v - previous", "v / 100") as a function of named values.
  def arithmetic(text, names) do
    true = text =~ ~r/\A[a-z0-9 .+\-*\/()]+\z/
    {:ok, ast} = Code.string_to_quoted(text)
    fn values -> ast |> Code.eval_quoted(Enum.zip(names, values)) |> elem(0) |> whole(values) end
  end

  # Integers divide to integers, as in the language of the reference.
  defp whole(result, values) when is_float(result) do
    if Enum.all?(values, &is_integer/1), do: trunc(result), else: result
  end

  defp whole(result, _values), do: result

  defp in_order(streams), do: streams |> Enum.sort() |> Enum.map(&elem(&1, 1))
end
