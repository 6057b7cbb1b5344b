Code.require_file("space.exs", __DIR__)

defmodule Situ.Bench.Beside do
  @turns 30
  @calls 5

  @moduledoc """
  `kernels-beside-python`: the jobs of `kernels` and two of `space`, #{@calls} calls here and
  #{@calls} in Python (`bench/python/kernels.py serve`) in #{@turns} alternating blocks, so that
  other load on the machine affects both. Prints the wall time of a call in microseconds,
  including overhead and result: the minimum and the median of all calls, and their ratios to the
  fastest Python library. Images have 8 bits per channel, and audio is 32-bit float on both sides.

  Python is `SITU_BENCH_PYTHON` (`python3`). The test is skipped if Python or its packages are not
  installed.
  """
  # Files are compiled in the order of their names, so space.exs is compiled after this one.
  @compile {:no_warn_undefined, Situ.Bench.Space}
  alias Situ.Bench.{Kernels, Space}

  def tests, do: [{"kernels-beside-python", &beside/1}]

  defp beside(scale) do
    turns = max(round(@turns * scale), 2)

    case open() do
      {:ok, port, names} ->
        metrics =
          Enum.flat_map(Kernels.jobs() ++ Space.beside(), &compare(&1, port, names, turns))

        Port.close(port)
        metrics

      :error ->
        IO.puts(:stderr, "Python's OpenCV and NumPy are not installed: nothing to compare with")
        []
    end
  end

  # The script prints the names of its jobs first.
  defp open do
    python = System.find_executable(System.get_env("SITU_BENCH_PYTHON") || "python3")
    script = Path.expand("../python/kernels.py", __DIR__)

    if python do
      args = [:binary, :exit_status, line: 4096, args: [script, "serve"]]
      port = Port.open({:spawn_executable, python}, args)
      with {:ok, line} <- line(port), do: {:ok, port, String.split(line)}
    else
      :error
    end
  end

  defp line(port) do
    receive do
      {^port, {:data, {:eol, line}}} -> {:ok, line}
      {^port, {:exit_status, _}} -> :error
    end
  end

  defp compare({name, _n, job}, port, names, turns) do
    peers = Enum.filter(names, &String.starts_with?(&1, name <> "_"))

    python =
      for peer <- peers,
          do: {String.replace_prefix(peer, name <> "_", ""), &there(port, peer, &1)}

    sides = [{"situ", &here(name, job, &1)} | python]

    times =
      for turn <- 0..turns, {side, calls} <- sides, us <- calls.(@calls), turn > 0, do: {side, us}

    if peers == [],
      do: [],
      else: report("beside_" <> name, Enum.group_by(times, &elem(&1, 0), &elem(&1, 1)))
  end

  defp here(name, job, calls) do
    for _ <- 1..calls do
      started = :erlang.monotonic_time(:nanosecond)
      right? = job.()
      elapsed = :erlang.monotonic_time(:nanosecond) - started
      unless right?, do: raise("#{name}: wrong result")
      # Python frees its results immediately, too.
      :erlang.garbage_collect()
      elapsed / 1000
    end
  end

  defp there(port, name, calls) do
    Port.command(port, "#{name} #{calls}\n")
    {:ok, line} = line(port)
    line |> String.split() |> Enum.map(&String.to_float/1)
  end

  defp report(metric, times) do
    for {label, of} <- [least: &Enum.min/1, median: &median/1], row <- rows(times, of) do
      {what, value, unit} = row
      {"#{metric}_#{label}_#{what}", value, unit}
    end
  end

  defp rows(times, of) do
    {ours, theirs} = times |> Map.new(fn {side, us} -> {side, of.(us)} end) |> Map.pop!("situ")
    best = theirs |> Map.values() |> Enum.min()

    [{"situ", ours, "us"}] ++
      for({side, us} <- theirs, do: {side, us, "us"}) ++ [{"ratio", ours / best, "x"}]
  end

  defp median(values), do: values |> Enum.sort() |> Enum.at(div(length(values), 2))
end
