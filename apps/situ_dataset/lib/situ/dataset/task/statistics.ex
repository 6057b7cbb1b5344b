defmodule Situ.Dataset.Task.Statistics do
  @moduledoc false
  # Writes count, mean, deviation and range of every numeric stream to a JSON file next to the
  # session's recordings (task `statistics`).
  @behaviour Situ.Dataset.Task

  @impl true
  def task do
    %{
      name: "statistics",
      about:
        "count, mean, deviation and range of every numeric stream, in a JSON file next to the recordings",
      output: nil,
      options: [
        file: [
          type: :string,
          default: "statistics.json",
          doc: "The file's name, which follows the session's name."
        ]
      ]
    }
  end

  @impl true
  def build(_p, opts) do
    folder = opts[:folder]
    name = "#{opts[:session].name}.#{opts[:file]}"
    totals = :ets.new(:statistics, [:public])

    for {partition, info} <- opts[:streams], info.type in [:integer, :float, :number, :boolean] do
      key = "[#{partition}]:#{info.name}"

      key
      |> opts[:open].()
      |> Situ.scan(nil, &add_value/2)
      |> Situ.each(&:ets.insert(totals, {key, &1}))
    end

    Situ.Pipeline.on(opts[:pipeline], :completed, fn _report ->
      all =
        for {key, total} <- :ets.tab2list(totals), into: %{}, do: {key, summarize_totals(total)}

      :ok = File.write(Path.join(folder, name), Situ.JSON.encode_pretty(all) <> "\n")
    end)
  end

  # Welford's running mean and sum of squared differences.
  defp add_value(value, total), do: to_number(value) |> update_totals(total)

  defp to_number(true), do: 1
  defp to_number(false), do: 0
  defp to_number(n), do: n

  defp update_totals(x, nil), do: {1, x / 1, 0.0, x, x}

  defp update_totals(x, {n, mean, squares, least, most}) do
    delta = x - mean
    mean = mean + delta / (n + 1)
    {n + 1, mean, squares + delta * (x - mean), min(least, x), max(most, x)}
  end

  defp summarize_totals({n, mean, squares, least, most}) do
    %{
      count: n,
      mean: mean,
      deviation: if(n > 1, do: :math.sqrt(squares / (n - 1))),
      least: least,
      most: most
    }
  end
end
