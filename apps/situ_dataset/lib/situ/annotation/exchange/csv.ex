defmodule Situ.Annotation.Exchange.Csv do
  @moduledoc false
  # Annotations as a table (RFC 4180): `from`, `to` (ns), `track`, one column per attribute, then
  # `by`, `confidence`, `proposed` and `note`. Nothing is lost. `from` and `to` are absolute times
  # and do not depend on `origin:`; `from_s` and `to_s` are seconds from the origin, for people
  # and spreadsheets.
  #
  # Reading requires `track` and either `from` and `to` (ns) or `from_s` and `to_s`; every other
  # column is an attribute.
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation
  alias Situ.Annotation.Exchange.LabelRows
  alias Situ.Annotation.{Layer, Schema}
  alias Situ.CsvRow

  @own ~w(from to from_s to_s track by confidence proposed note)

  @impl true
  def encode(layer, opts) do
    attributes = Enum.map(layer.schema.attributes, & &1.name)

    head =
      ~w(from to from_s to_s track) ++
        Enum.map(attributes, &column_name/1) ++ ~w(by confidence proposed note)

    rows = for a <- Layer.annotations(layer), do: build_row(a, attributes, opts[:origin])
    {Enum.map([head | rows], &CsvRow.encode_row/1), []}
  end

  # An attribute with the name of a fixed column gets a prefix.
  defp column_name(name), do: if(name in @own, do: "value." <> name, else: name)

  defp build_row(a, attributes, origin) do
    values = for name <- attributes, do: LabelRows.value_to_text(a.values[name])

    seconds =
      for time <- [a.from, a.to],
          do: :erlang.float_to_binary((time - origin) / 1.0e9, decimals: 6)

    [to_string(a.from), to_string(a.to)] ++
      seconds ++
      [a.track | values] ++
      [a.by || "", to_string(a.confidence || ""), to_string(a.proposed?), a.note || ""]
  end

  @impl true
  def decode(text, opts) do
    with {:ok, [head | rows]} <- parse_table(text),
         :ok <- check_columns(head) do
      {annotations, bad} =
        Enum.flat_map_reduce(rows, 0, fn cells, bad ->
          case parse_annotation(Map.new(Enum.zip(head, cells)), opts) do
            {:ok, annotation} -> {[annotation], bad}
            :error -> {[], bad + 1}
          end
        end)

      losses =
        if bad > 0,
          do: ["#{bad} rows are not annotations or do not fit the schema, and are left out"],
          else: []

      {:ok, nil, annotations, losses}
    else
      {:ok, []} -> {:error, "it is empty"}
      {:error, why} -> {:error, why}
    end
  end

  defp check_columns(head) do
    cond do
      "track" not in head ->
        {:error, "it has no column \"track\""}

      Enum.all?(~w(from to), &(&1 in head)) or Enum.all?(~w(from_s to_s), &(&1 in head)) ->
        :ok

      true ->
        {:error,
         "it has neither the columns \"from\" and \"to\" (ns) nor \"from_s\" and \"to_s\""}
    end
  end

  defp parse_annotation(row, opts) do
    with {:ok, from} <- parse_time(row["from"], row["from_s"], opts),
         {:ok, to} <- parse_time(row["to"], row["to_s"], opts),
         {:ok, values} <-
           row
           |> Map.drop(@own)
           |> take_cells(row["track"], opts[:schema])
           |> parse_values(opts[:schema]),
         annotation = %Annotation{
           from: from,
           to: to,
           track: row["track"],
           values: values,
           by: non_empty_text(row["by"]),
           note: non_empty_text(row["note"]),
           confidence: parse_confidence(non_empty_text(row["confidence"])),
           proposed?: row["proposed"] == "true"
         },
         :ok <- Annotation.check_fields(annotation) do
      {:ok, annotation}
    else
      _ -> :error
    end
  end

  defp non_empty_text(text) when text in [nil, ""], do: nil
  defp non_empty_text(text), do: text

  defp parse_time(ns, s, opts) do
    case {parse_integer(ns), s && Float.parse(s)} do
      {{:ok, ns}, _} -> {:ok, ns}
      {_, {seconds, ""}} -> {:ok, round(seconds * 1.0e9) + (opts[:origin] || 0)}
      _ -> :error
    end
  end

  defp parse_integer(nil), do: :error

  defp parse_integer(text) do
    case Integer.parse(text) do
      {n, ""} -> {:ok, n}
      _ -> :error
    end
  end

  defp parse_confidence(nil), do: nil

  defp parse_confidence(text) do
    case Float.parse(text) do
      {x, ""} -> x
      _ -> text
    end
  end

  # An annotation of a tier has a value in the column of its attribute only.
  defp take_cells(cells, track, schema) do
    case schema && track && Schema.find_tier(schema, track) do
      nil -> cells
      tier -> Map.take(cells, [tier.attribute, column_name(tier.attribute)])
    end
  end

  defp parse_values(cells, schema) do
    Enum.reduce_while(cells, {:ok, %{}}, fn {column, text}, {:ok, values} ->
      name = String.replace_prefix(column, "value.", "")

      case parse_value(schema, name, text) do
        {:ok, value} -> {:cont, {:ok, Map.put(values, name, value)}}
        _ -> {:halt, :error}
      end
    end)
  end

  defp parse_value(nil, _name, text), do: {:ok, text}
  defp parse_value(schema, name, text), do: Schema.parse_value(schema, name, text)

  defp parse_table(<<0xEF, 0xBB, 0xBF, text::binary>>), do: parse_table(text)

  defp parse_table(text) do
    if String.valid?(text),
      do: text |> end_lines() |> CsvRow.parse_rows(),
      else: {:error, "it is not UTF-8"}
  end

  # Some programs end lines with a carriage return only.
  defp end_lines(text),
    do: if(String.contains?(text, "\n"), do: text, else: String.replace(text, "\r", "\n"))
end
