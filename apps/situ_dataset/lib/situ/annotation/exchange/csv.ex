defmodule Situ.Annotation.Exchange.Csv do
  @moduledoc """
  Annotations as a table (RFC 4180): `from`, `to` (ns), `track`, one column per attribute, then `by`, `confidence`,
  `proposed` and `note`. Nothing is lost. `from` and `to` are absolute times and do not depend on `origin:`; `from_s`
  and `to_s` are seconds from the origin, for people and spreadsheets.

  Reading requires `track` and either `from` and `to` (ns) or `from_s` and `to_s`; every other column is an attribute.
  """
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation
  alias Situ.Annotation.Exchange.Rows
  alias Situ.Annotation.{Layer, Schema}

  @own ~w(from to from_s to_s track by confidence proposed note)

  @impl true
  def encode(layer, opts) do
    attributes = Enum.map(layer.schema.attributes, & &1.name)

    head =
      ~w(from to from_s to_s track) ++
        Enum.map(attributes, &column/1) ++ ~w(by confidence proposed note)

    rows = for a <- Layer.annotations(layer), do: row(a, attributes, opts[:origin])
    {Enum.map([head | rows], &line/1), []}
  end

  # An attribute with the name of a fixed column gets a prefix.
  defp column(name), do: if(name in @own, do: "value." <> name, else: name)

  defp row(a, attributes, origin) do
    values = for name <- attributes, do: Rows.text(a.values[name])

    seconds =
      for time <- [a.from, a.to],
          do: :erlang.float_to_binary((time - origin) / 1.0e9, decimals: 6)

    [to_string(a.from), to_string(a.to)] ++
      seconds ++
      [a.track | values] ++
      [a.by || "", to_string(a.confidence || ""), to_string(a.proposed?), a.note || ""]
  end

  defp line(cells), do: [cells |> Enum.map(&cell/1) |> Enum.intersperse(","), "\r\n"]

  defp cell(text) do
    if text =~ ~r/[",\r\n]/ or String.trim(text) != text,
      do: ["\"", String.replace(text, "\"", "\"\""), "\""],
      else: text
  end

  @impl true
  def decode(text, opts) do
    with {:ok, [head | rows]} <- table(text),
         :ok <- columns(head) do
      {annotations, bad} =
        Enum.flat_map_reduce(rows, 0, fn cells, bad ->
          case annotation(Map.new(Enum.zip(head, cells)), opts) do
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

  defp columns(head) do
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

  defp annotation(row, opts) do
    with {:ok, from} <- time(row["from"], row["from_s"], opts),
         {:ok, to} <- time(row["to"], row["to_s"], opts),
         {:ok, values} <- values(Map.drop(row, @own), opts[:schema]),
         annotation = %Annotation{
           from: from,
           to: to,
           track: row["track"],
           values: values,
           by: said(row["by"]),
           note: said(row["note"]),
           confidence: confidence(said(row["confidence"])),
           proposed?: row["proposed"] == "true"
         },
         :ok <- Annotation.check(annotation) do
      {:ok, annotation}
    else
      _ -> :error
    end
  end

  defp said(text) when text in [nil, ""], do: nil
  defp said(text), do: text

  defp time(ns, s, opts) do
    case {whole(ns), s && Float.parse(s)} do
      {{:ok, ns}, _} -> {:ok, ns}
      {_, {seconds, ""}} -> {:ok, round(seconds * 1.0e9) + (opts[:origin] || 0)}
      _ -> :error
    end
  end

  defp whole(nil), do: :error

  defp whole(text) do
    case Integer.parse(text) do
      {n, ""} -> {:ok, n}
      _ -> :error
    end
  end

  defp confidence(nil), do: nil

  defp confidence(text) do
    case Float.parse(text) do
      {x, ""} -> x
      _ -> text
    end
  end

  defp values(cells, schema) do
    Enum.reduce_while(cells, {:ok, %{}}, fn {column, text}, {:ok, values} ->
      name = String.replace_prefix(column, "value.", "")

      case value(schema, name, text) do
        {:ok, value} -> {:cont, {:ok, Map.put(values, name, value)}}
        _ -> {:halt, :error}
      end
    end)
  end

  defp value(nil, _name, text), do: {:ok, text}
  defp value(schema, name, text), do: Schema.read(schema, name, text)

  defp table(<<0xEF, 0xBB, 0xBF, text::binary>>), do: table(text)

  defp table(text) do
    if String.valid?(text), do: rows(text, [], []), else: {:error, "it is not UTF-8"}
  end

  defp rows("", [], rows), do: {:ok, Enum.reverse(rows)}

  defp rows(text, cells, rows) do
    case take_cell(text) do
      {:ok, cell, "," <> rest} -> rows(rest, [cell | cells], rows)
      {:ok, cell, rest} -> next_row(rest, ended([cell | cells], rows))
      :error -> {:error, "a quoted cell has no closing quotation mark"}
    end
  end

  defp ended([""], rows), do: rows
  defp ended(cells, rows), do: [Enum.reverse(cells) | rows]

  defp next_row("\r\n" <> rest, rows), do: rows(rest, [], rows)
  defp next_row("\n" <> rest, rows), do: rows(rest, [], rows)
  defp next_row("\r" <> rest, rows), do: rows(rest, [], rows)
  defp next_row("", rows), do: {:ok, Enum.reverse(rows)}
  defp next_row(_, _rows), do: {:error, "a quoted cell is followed by other text"}

  defp take_cell("\"" <> text), do: quoted(text, "")

  defp take_cell(text) do
    [cell] = Regex.run(~r/\A[^,\r\n]*/u, text)
    {:ok, cell, binary_part(text, byte_size(cell), byte_size(text) - byte_size(cell))}
  end

  defp quoted(text, value) do
    case String.split(text, "\"", parts: 2) do
      [part, "\"" <> rest] -> quoted(rest, value <> part <> "\"")
      [part, rest] -> {:ok, value <> part, rest}
      [_] -> :error
    end
  end
end
