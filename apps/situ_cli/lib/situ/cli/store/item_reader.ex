defmodule Situ.CLI.Store.ItemReader do
  @moduledoc false
  # Reads an enumerable item by item, so that several can be read in step.

  @type t :: function() | nil

  @doc "Returns the next item and the rest, or `nil` at the end."
  @spec next_item(Enumerable.t() | t()) :: {term(), t()} | nil
  def next_item(tape) when is_function(tape, 1), do: resume_tape(tape)
  def next_item(nil), do: nil

  @spec open(Enumerable.t()) :: t()
  def open(enumerable), do: &Enumerable.reduce(enumerable, &1, fn item, _ -> {:suspend, item} end)

  defp resume_tape(tape) do
    case tape.({:cont, nil}) do
      {:suspended, item, rest} -> {item, rest}
      {:done, _} -> nil
      {:halted, _} -> nil
    end
  end

  @doc "Merges tagged enumerables in order of `key` and returns an enumerable of `{tag, item}`."
  @spec merge([{term(), Enumerable.t()}], (term() -> term())) :: Enumerable.t()
  def merge(tagged, key) do
    Stream.resource(
      fn ->
        for {tag, enumerable} <- tagged,
            {item, rest} <- [next_item(open(enumerable))],
            do: {tag, item, rest}
      end,
      fn
        [] ->
          {:halt, []}

        heads ->
          {tag, item, rest} = first = Enum.min_by(heads, fn {_, item, _} -> key.(item) end)
          others = List.delete(heads, first)

          case next_item(rest) do
            nil -> {[{tag, item}], others}
            {following, rest} -> {[{tag, item}], [{tag, following, rest} | others]}
          end
      end,
      fn _ -> :ok end
    )
  end
end
