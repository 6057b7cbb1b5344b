defmodule Situ.Metrics.TextFormat do
  @moduledoc false
  # Encodes metrics in the text format of Prometheus 0.0.4
  # (https://prometheus.io/docs/instrumenting/exposition_formats/). Pure.
  @name ~r/\A[a-zA-Z_:][a-zA-Z0-9_:]*\z/

  @doc "Encodes metrics. Samples of metrics with the same name are together, as the format requires."
  @spec encode([Situ.Metrics.metric()]) :: iodata()
  def encode(metrics) do
    metrics
    |> Enum.filter(&(&1.name =~ @name and &1.samples != []))
    |> Enum.group_by(& &1.name)
    |> Enum.sort()
    |> Enum.map(fn {_name, [first | _] = same} -> encode_metric(first, same) end)
  end

  defp encode_metric(%{name: name, type: type, help: help}, same) do
    samples = Enum.flat_map(same, & &1.samples)

    [
      ["# HELP ", name, " ", escape_help(help), "\n# TYPE ", name, " ", to_string(type), "\n"]
      | Enum.map(samples, &encode_sample(name, &1))
    ]
  end

  defp encode_sample(name, {labels, value, :sum}), do: sample_line([name, "_sum"], labels, value)

  defp encode_sample(name, {labels, value, :count}),
    do: sample_line([name, "_count"], labels, value)

  defp encode_sample(name, {labels, value, :bucket}),
    do: sample_line([name, "_bucket"], labels, value)

  defp encode_sample(name, {labels, value, :quantile}), do: sample_line(name, labels, value)
  defp encode_sample(name, {labels, value}), do: sample_line(name, labels, value)

  defp sample_line(name, labels, value),
    do: [name, encode_labels(labels), " ", encode_value(value), "\n"]

  defp encode_labels([]), do: ""

  defp encode_labels(labels) do
    pairs =
      for {key, value} <- labels, do: [Atom.to_string(key), "=\"", escape_label(value), "\""]

    ["{", Enum.intersperse(pairs, ","), "}"]
  end

  defp encode_value(value) when is_integer(value), do: Integer.to_string(value)
  defp encode_value(value) when is_float(value), do: Float.to_string(value)

  defp escape_help(text), do: escape(text, [{"\\", "\\\\"}, {"\n", "\\n"}])
  defp escape_label(text), do: escape(text, [{"\\", "\\\\"}, {"\n", "\\n"}, {"\"", "\\\""}])

  # Names of streams may be any bytes, but the format is UTF-8.
  defp escape(text, replacements) do
    text = if String.valid?(text), do: text, else: inspect(text)
    Enum.reduce(replacements, text, fn {from, to}, text -> String.replace(text, from, to) end)
  end
end
