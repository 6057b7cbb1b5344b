defmodule Situ.Studio.Visualizers.Value do
  @moduledoc false
  # Shows any message at the cursor as a tree of its values, with the differences to the message before.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, StreamReader, ValuePath, ValueTree, Visualizer}
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
  def instant(channel, data, message, context) do
    tree = ValueTree.build(data)

    Frame.json(
      channel,
      message.originating_time,
      Map.merge(compare_before(data, tree, message, context), %{
        "tree" => tree,
        "time" => Integer.to_string(message.originating_time),
        "sequence" => message.sequence_id,
        "latency" => Situ.Message.latency(message),
        "type" => type_name(data)
      })
    )
  end

  # A second image might have to be decoded, and its bytes are not comparable.
  defp compare_before(%module{}, _, _, _)
       when module in [Situ.Image, Situ.EncodedImage, Situ.DepthImage],
       do: %{}

  defp compare_before(_, tree, message, %{source: source, spec: %{stream: stream, path: path}}) do
    with [before] <-
           StreamReader.list_neighbours(source, stream, :before, message.originating_time, 1),
         {:ok, data} <- ValuePath.fetch(before.data, path),
         do: data |> ValueTree.build() |> ValueTree.list_changes(tree),
         else: (_ -> %{})
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
