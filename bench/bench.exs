# The benchmark runner: `bin/bench TEST [REPS] [SCALE]`. bench/README.md describes its output.
Code.require_file("measure.exs", __DIR__)

defmodule Situ.Bench.Runner do
  @moduledoc false
  # Runs one benchmark and prints `name,value,unit` lines on standard output.
  #
  # A benchmark is an entry of `tests/0 :: [{name, fun}]` of a module in `bench/tests/`.
  # `fun.(scale)` runs one repetition and returns `[{metric, value, unit}]`. It raises if its own
  # counts or sums are wrong.

  @quick ~w(empty chain-1-unlimited chain-10-unlimited join-exact-unlimited zip-unlimited storeint-unlimited seek)

  def main([name | rest]) do
    load_tests(name)
    if name == "list", do: Enum.each(names(), &IO.puts/1), else: run_selected(name, rest)
  end

  def main([]), do: fail("bench", "no benchmark is named")

  # Compiling all tests takes seconds. Most tests are in a file with their first word.
  defp load_tests(name) do
    files = Path.wildcard(Path.join(__DIR__, "tests/*.exs"))
    {likely, others} = Enum.split_with(files, &String.starts_with?(name, first_word(&1)))
    Enum.each(likely, &Code.require_file/1)
    if select(name) == [], do: Enum.each(others, &Code.require_file/1)
  end

  defp first_word(file), do: file |> Path.basename(".exs") |> String.split("_") |> hd()

  defp run_selected(name, rest) do
    {reps, scale} = parse(name, rest)

    case select(name) do
      [] -> fail(name, "no benchmark #{inspect(name)}#{hint(name)} (`bin/bench list` shows all)")
      [one] -> run(one, reps, scale)
      many -> many |> Enum.reject(&spawn_vm(&1, reps, scale)) |> report_failed()
    end
  end

  defp select("all"), do: names()
  defp select("quick"), do: Enum.filter(@quick, &(&1 in names()))
  defp select("growth"), do: Enum.filter(names(), &String.starts_with?(&1, "growth-"))
  defp select(name), do: if(name in names(), do: [name], else: [])

  defp hint(name) do
    case Situ.Options.nearest_name(name, names()) do
      nil -> ""
      near -> "; did you mean #{near}?"
    end
  end

  defp parse(name, rest) do
    with true <- length(rest) <= 2,
         {:ok, reps} <- number(Enum.at(rest, 0, "5"), &Integer.parse/1),
         {:ok, scale} <- number(add_leading_zero(Enum.at(rest, 1, "1")), &Float.parse/1) do
      {reps, scale}
    else
      _ ->
        fail(
          name,
          "invalid arguments #{inspect(Enum.join(rest, " "))}: REPS must be a whole number " <>
            "above 0, and SCALE a number above 0, as in: bin/bench #{name} 3 .5"
        )
    end
  end

  defp add_leading_zero("." <> _ = text), do: "0" <> text
  defp add_leading_zero(text), do: text

  defp number(text, parse) do
    case parse.(text) do
      {n, ""} when n > 0 -> {:ok, n}
      _ -> :error
    end
  end

  # Every test runs in a new VM, so that garbage and warm caches of one test do not affect
  # another. Returns whether the test succeeded.
  defp spawn_vm(name, reps, scale) do
    script = System.get_env("SITU_BENCH") || "bin/bench"
    args = [name, "#{reps}", "#{scale}"]
    {_, status} = System.cmd(script, args, into: IO.stream(:stdio, :line))
    status == 0
  end

  defp report_failed([]), do: :ok

  defp report_failed(names) do
    IO.puts(:stderr, "bench: #{length(names)} failed: #{Enum.join(names, " ")}")
    System.halt(1)
  end

  defp run(name, reps, scale) do
    {^name, fun} = List.keyfind(tests(), name, 0)
    IO.puts(:stderr, "#{name}: #{reps} repetitions at scale #{scale}")
    # The warm-up loads code and makes compiled paths hot. A tenth of the work is enough.
    fun.(scale / 10)

    1..reps
    |> Enum.flat_map(fn rep ->
      metrics = fun.(scale)
      IO.puts(:stderr, "  #{rep}: " <> Enum.map_join(metrics, "  ", &show/1))
      metrics
    end)
    |> Kernel.++([{name <> "_peak_rss", Situ.Bench.peak_rss_mib(), "MiB"}])
    |> report()
  catch
    kind, reason ->
      IO.puts(:stderr, Exception.format(kind, reason, __STACKTRACE__))
      IO.puts("failed_#{name},1,exit")
      System.halt(1)
  end

  defp show({metric, value, unit}), do: "#{metric}=#{format(value)} #{unit}"

  defp report(metrics) do
    order = metrics |> Enum.map(&elem(&1, 0)) |> Enum.uniq()
    by_name = Enum.group_by(metrics, &elem(&1, 0))

    for metric <- order do
      values = by_name[metric] |> Enum.map(&elem(&1, 1)) |> Enum.sort()
      unit = by_name[metric] |> hd() |> elem(2)
      IO.puts("#{metric},#{format(median(values))},#{unit}")

      if length(values) > 1 do
        IO.puts("#{metric}.min,#{format(hd(values))},#{unit}")
        IO.puts("#{metric}.max,#{format(List.last(values))},#{unit}")
      end
    end
  end

  defp median(sorted) do
    n = length(sorted)
    upper = Enum.at(sorted, div(n, 2))
    if rem(n, 2) == 1, do: upper, else: (upper + Enum.at(sorted, div(n, 2) - 1)) / 2
  end

  defp format(value) when is_integer(value), do: Integer.to_string(value)
  defp format(value) when abs(value) >= 100, do: :erlang.float_to_binary(value, decimals: 1)
  defp format(value), do: :erlang.float_to_binary(value * 1.0, decimals: 4)

  defp names, do: Enum.map(tests(), &elem(&1, 0))

  defp tests, do: Enum.flat_map(test_modules(), & &1.tests())

  defp test_modules do
    loaded = for {module, _} <- :code.all_loaded(), do: module

    loaded
    |> Enum.filter(&String.starts_with?(Atom.to_string(&1), "Elixir.Situ.Bench."))
    |> Enum.filter(&function_exported?(&1, :tests, 0))
    |> Enum.sort()
  end

  # Programs that read only standard output see the failure too.
  defp fail(name, problem) do
    IO.puts("failed_#{name},1,exit")
    IO.puts(:stderr, "bench: #{problem}")
    IO.puts(:stderr, "Usage: bin/bench TEST|growth|quick|all|list [REPS] [SCALE]")
    System.halt(2)
  end
end

Situ.Bench.Runner.main(System.argv())
