defmodule Situ.Test.MetricsText do
  @moduledoc false
  # Reads the text format of Prometheus and checks its rules, without any code of `Situ.Metrics`:
  # https://prometheus.io/docs/instrumenting/exposition_formats/ and the naming rules of `promtool check metrics`.
  import ExUnit.Assertions

  @sample ~r/\A([a-zA-Z_:][a-zA-Z0-9_:]*)(?:\{(.*)\})? (\S+)\z/su
  @label ~r/\G([a-zA-Z_][a-zA-Z0-9_]*)="((?:[^"\\\n]|\\[\\"n])*)"(?:,|\z)/su

  @doc "Returns `%{name => {type, [{name of the sample, labels, value}]}}`; fails if the text breaks a rule."
  def parse!(text) do
    assert String.valid?(text) and String.ends_with?(text, "\n")
    families = text |> String.split("\n", trim: true) |> read_families([])
    names = Enum.map(families, &elem(&1, 0))
    assert names == Enum.uniq(names), "a metric is described twice"
    samples = for {_, _, samples} <- families, {name, labels, _} <- samples, do: {name, labels}
    assert samples == Enum.uniq(samples), "a series appears twice"
    for family <- families, do: check_family(family)
    Map.new(families, fn {name, type, samples} -> {name, {type, samples}} end)
  end

  defp read_families([], families), do: Enum.reverse(families)

  defp read_families(["# HELP " <> help, "# TYPE " <> type | lines], families) do
    [name, text] = String.split(help, " ", parts: 2)
    [^name, type] = String.split(type, " ")
    assert text != "", "#{name} has no help"
    assert type in ~w(counter gauge histogram summary)
    {samples, lines} = Enum.split_while(lines, &(not String.starts_with?(&1, "#")))
    read_families(lines, [{name, type, Enum.map(samples, &read_sample/1)} | families])
  end

  defp read_sample(line) do
    assert [_, name, labels, value] = Regex.run(@sample, line), "not a sample: #{line}"
    pairs = for [_, key, value] <- Regex.scan(@label, labels), do: {key, value}

    size =
      for [match | _] <- Regex.scan(@label, labels), reduce: 0, do: (n -> n + byte_size(match))

    assert size == byte_size(labels), "invalid labels: #{line}"
    assert {number, ""} = Float.parse(value)
    {name, Map.new(pairs), number}
  end

  defp check_family({name, "counter", samples}) do
    assert String.ends_with?(name, "_total")
    for {^name, _labels, value} <- samples, do: assert(value >= 0)
  end

  defp check_family({name, "gauge", samples}) do
    refute String.ends_with?(name, "_total") or String.ends_with?(name, "_count")
    for sample <- samples, do: assert({^name, _, _} = sample)
  end

  defp check_family({name, "histogram", samples}) do
    grouped = Enum.group_by(samples, fn {_, labels, _} -> Map.delete(labels, "le") end)

    for {_labels, samples} <- grouped do
      buckets = for {n, l, value} <- samples, n == name <> "_bucket", do: {l["le"], value}
      {limits, counts} = Enum.unzip(buckets)
      assert {numbers, ["+Inf"]} = Enum.split(limits, -1)
      numbers = Enum.map(numbers, &String.to_float/1)
      assert numbers == Enum.sort(numbers) |> Enum.uniq()
      assert counts == Enum.sort(counts), "buckets are not cumulative"
      assert [{_, _, sum}] = for({n, _, _} = s <- samples, n == name <> "_sum", do: s)
      assert [{_, _, count}] = for({n, _, _} = s <- samples, n == name <> "_count", do: s)
      assert count == List.last(counts)
      assert count > 0 or sum == 0
    end
  end

  defp check_family({name, "summary", samples}),
    do: for({n, _, _} <- samples, do: assert(n in [name, name <> "_sum", name <> "_count"]))
end
