defmodule Situ.Studio.Visualizers.Script do
  @moduledoc """
  Implements the server's half of a visualizer that is only a script of a plug-in (`Situ.Studio.Plugins`). It sends the
  message at the cursor, or the messages of some seconds before it, as JSON.

  Numbers, strings, `true`, `false` and `nil` stay the same. Atoms become strings, lists and tuples become arrays, and
  maps and structs become objects (a struct has its name as `"type"`). Bytes that are not text become `{"bytes": SIZE}`,
  because images and audio have their own visualizers.

      iex> Situ.Studio.Visualizers.Script.to_json_term({:left, %Situ.Point2{x: 1.5, y: 2}})
      {:ok, ["left", %{"type" => "Situ.Point2", "x" => 1.5, "y" => 2}]}
  """
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.Draw.WindowMessages
  alias Situ.Studio.{Frame, Gap, ValuePath, Visualizer, StreamReader}

  @second 1_000_000_000
  @rows 5_000
  @values 200_000

  @impl true
  def about,
    do: %Visualizer{id: "script", title: "Script", panel: :own, shapes: [], drawer: "script"}

  @impl true
  def instant(channel, data, message, %{spec: %{viz: %{data: :message}}}) do
    case to_json_term(data) do
      {:ok, data} -> Frame.json(channel, message.originating_time, %{"data" => data})
      :error -> {:error, too_much()}
    end
  end

  # `rows` contains `[milliseconds before the newest, data]`, oldest first.
  def instant(channel, _data, message, %{source: source, spec: spec}) do
    to = message.originating_time
    settings = Visualizer.property_values(spec.viz, Map.get(spec, :props, %{}))
    from = to - round(Map.get(settings, :seconds, 10) * @second)

    with {:ok, messages, all?} <- read_past(source, spec.stream, from, to) do
      {rows, left} = Enum.reduce(messages, {[], @values}, &add_row(&1, &2, spec.path, to))

      if left > 0,
        do: Frame.json(channel, to, %{"rows" => Enum.reverse(rows), "sampled" => not all?}),
        else: {:error, too_much()}
    else
      {:error, error} -> {:error, error.what}
    end
  end

  defp read_past(source, stream, from, to) do
    with {:ok, messages, true} when length(messages) > @rows <-
           WindowMessages.fetch_within(source, stream, from, to),
         {:ok, rows} <- StreamReader.sample_messages(source, stream, from, to, @rows),
         do: {:ok, Enum.map(rows, &elem(&1, 1)), false}
  end

  defp add_row(_message, {rows, left}, _path, _to) when left <= 0, do: {rows, 0}
  defp add_row(%{data: %Gap{}}, acc, _path, _to), do: acc

  defp add_row(message, {rows, left}, path, to) do
    case ValuePath.fetch(message.data, path) do
      {:ok, data} ->
        {value, left} = convert_term(data, left)
        {[[(message.originating_time - to) / 1.0e6, value] | rows], left}

      :error ->
        {rows, left}
    end
  end

  defp too_much, do: "a script cannot receive more than #{@values} values"

  @doc "Converts a term for JSON. Returns `:error` if it is too large."
  @spec to_json_term(term()) :: {:ok, term()} | :error
  def to_json_term(term) do
    case convert_term(term, @values) do
      {_, left} when left <= 0 -> :error
      {value, _} -> {:ok, value}
    end
  end

  defp convert_term(_, left) when left <= 0, do: {nil, 0}
  defp convert_term(x, left) when is_number(x) or is_boolean(x) or is_nil(x), do: {x, left - 1}
  defp convert_term(x, left) when is_atom(x), do: {Atom.to_string(x), left - 1}

  defp convert_term(x, left) when is_binary(x) do
    if String.valid?(x),
      do: {x, left - 1 - div(byte_size(x), 64)},
      else: {%{"bytes" => byte_size(x)}, left - 1}
  end

  defp convert_term(list, left) when is_list(list), do: convert_list(list, [], left)

  defp convert_term(tuple, left) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> convert_term(left)

  defp convert_term(%module{} = struct, left) do
    {map, left} = struct |> Map.from_struct() |> convert_term(left)
    {Map.put(map, "type", inspect(module)), left}
  end

  defp convert_term(%{} = map, left) do
    {rows, left} =
      Enum.map_reduce(map, left - 1, fn {key, value}, left ->
        {value, left} = convert_term(value, left)
        {{key_text(key), value}, left}
      end)

    {Map.new(rows), left}
  end

  defp convert_term(other, left), do: {inspect(other, limit: 10), left - 1}

  defp convert_list([head | tail], done, left) when left > 0 do
    {value, left} = convert_term(head, left)
    convert_list(tail, [value | done], left)
  end

  defp convert_list([], done, left), do: {Enum.reverse(done), left - 1}
  defp convert_list(_, done, left) when left <= 0, do: {done, 0}

  # The tail of an improper list becomes its last element.
  defp convert_list(tail, done, left) do
    {value, left} = convert_term(tail, left)
    {Enum.reverse([value | done]), left}
  end

  defp key_text(key) when is_binary(key), do: if(String.valid?(key), do: key, else: inspect(key))
  defp key_text(key) when is_atom(key) or is_number(key), do: to_string(key)
  defp key_text(key), do: inspect(key, limit: 5)
end
