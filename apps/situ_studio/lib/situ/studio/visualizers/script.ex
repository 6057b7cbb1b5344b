defmodule Situ.Studio.Visualizers.Script do
  @moduledoc """
  The server's half of a visualizer that consists of a script only. It sends the message at the cursor, or the messages
  of some seconds before it, as JSON.

  Numbers, strings, `true`, `false` and `nil` stay the same. Atoms become strings, lists and tuples become arrays, and
  maps and structs become objects (a struct has its name as `"type"`). Bytes that are not text become `{"bytes": SIZE}`,
  because images and audio have visualizers.

      iex> Situ.Studio.Visualizers.Script.plain({:left, %Situ.Point2{x: 1.5, y: 2}})
      {:ok, ["left", %{"type" => "Situ.Point2", "x" => 1.5, "y" => 2}]}
  """
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.Draw.Messages
  alias Situ.Studio.{Frame, Hole, Path, Source, Visualizer}

  @second 1_000_000_000
  @rows 5_000
  @values 200_000

  @impl true
  def about,
    do: %Visualizer{id: "script", title: "Script", panel: :own, shapes: [], drawer: "script"}

  @impl true
  def instant(channel, data, message, %{spec: %{viz: %{data: :message}}}) do
    case plain(data) do
      {:ok, data} -> Frame.json(channel, message.originating_time, %{"data" => data})
      :error -> {:error, too_much()}
    end
  end

  # `rows` contains `[milliseconds before the newest, data]`, oldest first.
  def instant(channel, _data, message, %{source: source, spec: spec}) do
    to = message.originating_time
    settings = Visualizer.settings(spec.viz, Map.get(spec, :props, %{}))
    from = to - round(Map.get(settings, :seconds, 10) * @second)

    with {:ok, messages, all?} <- past(source, spec.stream, from, to) do
      {rows, left} = Enum.reduce(messages, {[], @values}, &row(&1, &2, spec.path, to))

      if left > 0,
        do: Frame.json(channel, to, %{"rows" => Enum.reverse(rows), "sampled" => not all?}),
        else: {:error, too_much()}
    else
      {:error, error} -> {:error, error.what}
    end
  end

  defp past(source, stream, from, to) do
    with {:ok, messages, true} when length(messages) > @rows <-
           Messages.within(source, stream, from, to),
         {:ok, rows} <- Source.sample(source, stream, from, to, @rows),
         do: {:ok, Enum.map(rows, &elem(&1, 1)), false}
  end

  defp row(_message, {rows, left}, _path, _to) when left <= 0, do: {rows, 0}
  defp row(%{data: %Hole{}}, acc, _path, _to), do: acc

  defp row(message, {rows, left}, path, to) do
    case Path.fetch(message.data, path) do
      {:ok, data} ->
        {value, left} = walk(data, left)
        {[[(message.originating_time - to) / 1.0e6, value] | rows], left}

      :error ->
        {rows, left}
    end
  end

  defp too_much, do: "a script cannot receive more than #{@values} values"

  @doc "Converts a term for JSON. Returns `:error` if it is too large."
  @spec plain(term()) :: {:ok, term()} | :error
  def plain(term) do
    case walk(term, @values) do
      {_, left} when left <= 0 -> :error
      {value, _} -> {:ok, value}
    end
  end

  defp walk(_, left) when left <= 0, do: {nil, 0}
  defp walk(x, left) when is_number(x) or is_boolean(x) or is_nil(x), do: {x, left - 1}
  defp walk(x, left) when is_atom(x), do: {Atom.to_string(x), left - 1}

  defp walk(x, left) when is_binary(x) do
    if String.valid?(x),
      do: {x, left - 1 - div(byte_size(x), 64)},
      else: {%{"bytes" => byte_size(x)}, left - 1}
  end

  defp walk(list, left) when is_list(list), do: each(list, [], left)
  defp walk(tuple, left) when is_tuple(tuple), do: tuple |> Tuple.to_list() |> walk(left)

  defp walk(%module{} = struct, left) do
    {map, left} = struct |> Map.from_struct() |> walk(left)
    {Map.put(map, "type", inspect(module)), left}
  end

  defp walk(%{} = map, left) do
    {rows, left} =
      Enum.map_reduce(map, left - 1, fn {key, value}, left ->
        {value, left} = walk(value, left)
        {{key(key), value}, left}
      end)

    {Map.new(rows), left}
  end

  defp walk(other, left), do: {inspect(other, limit: 10), left - 1}

  defp each([head | tail], done, left) when left > 0 do
    {value, left} = walk(head, left)
    each(tail, [value | done], left)
  end

  defp each([], done, left), do: {Enum.reverse(done), left - 1}
  defp each(_, done, left) when left <= 0, do: {done, 0}

  # The tail of an improper list becomes its last element.
  defp each(tail, done, left) do
    {value, left} = walk(tail, left)
    {Enum.reverse([value | done]), left}
  end

  defp key(key) when is_binary(key), do: if(String.valid?(key), do: key, else: inspect(key))
  defp key(key) when is_atom(key) or is_number(key), do: to_string(key)
  defp key(key), do: inspect(key, limit: 5)
end
