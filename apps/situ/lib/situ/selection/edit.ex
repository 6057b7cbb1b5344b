defmodule Situ.Selection.Edit do
  @moduledoc false
  # Merges a stream of edits into a stream. If both have a message at the same time, the edit applies.
  use Situ.Component, inputs: [in: :any, edits: :any], outputs: [out: :any]

  alias Situ.Fusion.Zip

  @doc "Sorts edits by time for a stream, and keeps the last of several at one time."
  @spec sort_edits([{Situ.Time.t(), {:put, term()} | :delete}]) :: [{Situ.Time.t(), term()}]
  def sort_edits(edits), do: edits |> Map.new(&check_edit/1) |> Enum.sort()

  @impl true
  def init(_opts), do: {:ok, Zip.new(2)}

  @impl true
  def handle_message(input, message, context, zip),
    do: handle_messages(input, [message], context, zip)

  @impl true
  def handle_messages(:in, messages, _context, zip) do
    messages = Enum.map(messages, &%{&1 | data: {:put, &1.data}})
    apply_edits(Zip.push(zip, 0, messages))
  end

  def handle_messages(:edits, messages, _context, zip),
    do: apply_edits(Zip.push(zip, 1, messages))

  @impl true
  def handle_closed(:in, _time, _context, zip), do: apply_edits(Zip.close(zip, 0))
  def handle_closed(:edits, _time, _context, zip), do: apply_edits(Zip.close(zip, 1))

  # An edit is the last element of its group.
  defp apply_edits({groups, zip}) do
    {for(
       {:out, time, group} <- groups,
       {:put, data} <- [List.last(group)],
       do: {:out, time, data}
     ), zip}
  end

  defp check_edit({time, {:put, _data}} = edit) when is_integer(time), do: edit
  defp check_edit({time, :delete} = edit) when is_integer(time), do: edit

  defp check_edit(other) do
    raise ArgumentError,
          "an edit must be {time, {:put, data}} or {time, :delete}, got: #{inspect(other)}"
  end
end
