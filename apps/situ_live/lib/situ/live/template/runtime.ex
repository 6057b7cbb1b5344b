defmodule Situ.Live.Template.Runtime do
  @moduledoc false
  # The functions that compiled templates call.
  alias Situ.Live.{Comprehension, Stream}

  @doc "Returns whether a value that reads these assigns must be computed again."
  def changed?(%{__changed__: %{} = changed}, names),
    do: Enum.any?(names, &is_map_key(changed, &1))

  def changed?(_, _), do: true

  def fetch!(assigns, name) do
    case assigns do
      %{^name => value} ->
        value

      _ ->
        available = assigns |> Map.keys() |> Enum.reject(&(&1 == :__changed__))
        raise KeyError, message: "no assign @#{name}; available: #{inspect(available)}"
    end
  end

  def comprehension(%Stream{} = stream, entries, %Comprehension{} = comprehension) do
    %{
      comprehension
      | entries: entries.(Stream.inserted_items(stream)),
        stream: Stream.to_wire(stream)
    }
  end

  def comprehension(enumerable, entries, %Comprehension{} = comprehension) do
    %{comprehension | entries: entries.(enumerable)}
  end
end
