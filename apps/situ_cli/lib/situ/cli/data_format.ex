defmodule Situ.CLI.DataFormat do
  @moduledoc false
  # Formats the contents of messages and metadata for people and for programs.

  @doc "Formats `data` on one line and truncates long values."
  @spec format_line(term()) :: String.t()
  def format_line(data), do: inspect(data, limit: 20, printable_limit: 200)

  @doc "Returns `data` if JSON can represent it, else its `text`."
  @spec to_json(term()) :: %{data: term()} | %{text: String.t()}
  def to_json(data) do
    case to_plain(data) do
      {:ok, value} -> %{data: value}
      :error -> %{text: format_line(data)}
    end
  end

  # Tuples become lists and atoms become strings, as everywhere else.
  defp to_plain(data) when is_number(data) or is_atom(data), do: {:ok, data}

  defp to_plain(data) when is_binary(data),
    do: if(String.valid?(data), do: {:ok, data}, else: :error)

  defp to_plain(data) when is_tuple(data), do: data |> Tuple.to_list() |> to_plain()
  # The pixels of an image are never text, even if their bytes happen to be printable.
  defp to_plain(%_{} = struct) do
    struct
    |> Map.from_struct()
    |> Map.new(fn {key, value} ->
      {key, if(raw_bytes?(value), do: %{bytes: byte_size(value)}, else: value)}
    end)
    |> to_plain()
  end

  defp to_plain([_ | _] = list) do
    if List.improper?(list), do: :error, else: convert_all(list)
  end

  defp to_plain([]), do: {:ok, []}

  defp to_plain(%{} = map) do
    {keys, values} = map |> Map.to_list() |> Enum.unzip()

    with true <- Enum.all?(keys, &(is_binary(&1) or is_atom(&1))),
         {:ok, values} <- convert_all(values) do
      {:ok, keys |> Enum.map(&to_string/1) |> Enum.zip(values) |> Map.new()}
    else
      _ -> :error
    end
  end

  defp to_plain(_), do: :error

  defp raw_bytes?(value),
    do: is_binary(value) and (byte_size(value) > 1_000 or not String.printable?(value))

  defp convert_all(list) do
    plain = Enum.map(list, &to_plain/1)
    if :error in plain, do: :error, else: {:ok, Enum.map(plain, &elem(&1, 1))}
  end
end
