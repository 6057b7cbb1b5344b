defmodule Situ.Studio.Visualizers.Value do
  @moduledoc false
  # Shows any message at the cursor as a tree of its values.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, ValueTree, Visualizer}
  alias Situ.Studio.Visualizers.SharedOptions

  @impl true
  def about do
    %Visualizer{
      id: "value",
      title: "Value",
      panel: :value,
      shapes: :any,
      options: SharedOptions.near_cursor(),
      asks: SharedOptions.requested_keys()
    }
  end

  @impl true
  def instant(channel, data, message) do
    Frame.json(channel, message.originating_time, %{
      "tree" => ValueTree.build(data),
      "time" => Integer.to_string(message.originating_time),
      "sequence" => message.sequence_id,
      "latency" => Situ.Message.latency(message),
      "type" => type_name(data)
    })
  end

  defp type_name(%module{}), do: inspect(module)

  defp type_name(data) when is_binary(data),
    do: if(String.valid?(data), do: "string", else: "binary")

  defp type_name(data) when is_boolean(data), do: "boolean"
  defp type_name(data) when is_atom(data), do: "atom"
  defp type_name(data) when is_integer(data), do: "integer"
  defp type_name(data) when is_float(data), do: "float"
  defp type_name(data) when is_list(data), do: "list"
  defp type_name(data) when is_tuple(data), do: "tuple"
  defp type_name(data) when is_map(data), do: "map"
  defp type_name(_), do: "term"
end
