defmodule Situ.Studio.Visualizers.Text do
  @moduledoc false
  # Draws the text at the cursor in large letters.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, Visualizer}
  alias Situ.Studio.Visualizers.SharedOptions

  @max_text 20_000

  @impl true
  def about do
    %Visualizer{
      id: "text",
      title: "Text",
      panel: :text,
      shapes: [:text],
      options: SharedOptions.near_cursor(),
      asks: SharedOptions.requested_keys()
    }
  end

  @impl true
  def instant(channel, data, message),
    do: Frame.json(channel, message.originating_time, %{"text" => display_text(data)})

  defp display_text(data) when is_binary(data) do
    if String.valid?(data), do: String.slice(data, 0, @max_text), else: inspect(data)
  end

  defp display_text(data), do: inspect(data, pretty: true, limit: 200, printable_limit: 4_000)
end
