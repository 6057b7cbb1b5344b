defmodule Situ.Studio.Web.Icons do
  @moduledoc false
  # Renders the studio's icons, 16 px line drawings in the color of the surrounding text.
  use Situ.Live.Component

  @paths %{
    play: "M4.5 3v10l8.5-5z",
    stop: "M4 4h8v8H4z",
    selection: "M3 3v10M13 3v10M5.5 8h5M8.7 5.8 11 8l-2.3 2.2",
    repeat: "M3 7a3 3 0 0 1 3-3h6M10 2l2 2-2 2M13 9a3 3 0 0 1-3 3H4M6 14l-2-2 2-2",
    slower: "M12 4 8 8l4 4M7 4 3 8l4 4",
    faster: "M4 4l4 4-4 4M9 4l4 4-4 4",
    fit: "M2 5V2h3M11 2h3v3M14 11v3h-3M5 14H2v-3M4.5 8h7",
    zoom: "M7 11.5a4.5 4.5 0 1 0 0-9 4.5 4.5 0 0 0 0 9zM10.5 10.5 14 14M5 7h4M7 5v4",
    follow: "M3 2.5l9 4.2-4 1.4-1.4 4z",
    clear: "M3 3v10M13 3v10M6 6l4 4M10 6l-4 4",
    link:
      "M7 9a3 3 0 0 0 4.2.2l2-2A3 3 0 0 0 9 3l-1 1M9 7a3 3 0 0 0-4.2-.2l-2 2A3 3 0 0 0 7 13l1-1",
    theme: "M8 2a6 6 0 1 0 6 6 4.6 4.6 0 0 1-6-6z",
    help:
      "M6 6.2a2 2 0 1 1 2.8 1.8c-.6.3-.8.7-.8 1.4M8 12v.1M8 14.5a6.5 6.5 0 1 0 0-13 6.5 6.5 0 0 0 0 13z",
    search: "M7 11.5a4.5 4.5 0 1 0 0-9 4.5 4.5 0 0 0 0 9zM10.5 10.5 14 14",
    close: "M4 4l8 8M12 4l-8 8",
    up: "M4 10l4-4 4 4",
    down: "M4 6l4 4 4-4",
    save: "M3 2.5h8l2.5 2.5v8.5h-10.5zM5 2.5V6h5V2.5M5 13.5V9h6v4.5",
    store: "M2.5 4.5h4l1.2 1.5h5.8v6.5h-11z",
    pipeline: "M2.5 8h3M10.5 4h3M10.5 12h3M5.5 6h5v4h-5zM10.5 4v8",
    grip: "M6 3.5v.1M10 3.5v.1M6 8v.1M10 8v.1M6 12.5v.1M10 12.5v.1",
    export: "M8 2v7.5M5 6.8l3 3 3-3M2.5 10.5v3h11v-3",
    info: "M3 4h4M3 8h4M3 12h4M10 4h3M10 8h3M10 12h3",
    grow: "M9.5 2.5h4v4M6.5 13.5h-4v-4M13.5 2.5l-4.5 4.5M2.5 13.5l4.5-4.5",
    shrink: "M13 7H9V3M3 9h4v4M9 7l4.5-4.5M7 9l-4.5 4.5",
    beside: "M2.5 3h11v10h-11zM6.5 3v10M6.5 8h7",
    undo: "M6 4L3 7l3 3M3 7h6.5a3 3 0 0 1 0 6H7",
    redo: "M10 4l3 3-3 3M13 7H6.5a3 3 0 0 0 0 6H9",
    mark: "M3.5 13V3h8l-2 3 2 3h-8",
    side: "M2.5 3h11v10h-11zM10 3v10",
    streams: "M2.5 4h2M6.5 4h7M4.5 8h2M8.5 8h5M4.5 12h2M8.5 12h5",
    more: "M3 8v.1M8 8v.1M13 8v.1",
    tune: "M2.5 5h6M11.5 5h2M2.5 11h2M7.5 11h6M10 3.5v3M6 9.5v3"
  }

  attr(:name, :atom, required: true)
  attr(:class, :string, default: nil)

  @spec icon(map()) :: Situ.Live.Rendered.t()
  def icon(assigns) do
    assigns = assign(assigns, :path, Map.fetch!(@paths, assigns.name))

    ~H"""
    <svg
      class={@class}
      viewBox="0 0 16 16"
      fill={if @name in [:play, :stop], do: "currentColor", else: "none"}
      stroke="currentColor"
      stroke-width="1.5"
      stroke-linecap="round"
      stroke-linejoin="round"
      aria-hidden="true"
    ><path d={@path}></path></svg>
    """
  end

  attr(:act, :string, required: true)
  attr(:icon, :atom, required: true)
  attr(:title, :string, required: true)
  attr(:class, :string, default: nil)

  @doc false
  def tool_button(assigns) do
    ~H"""
    <button class={["tool", @class]} type="button" data-act={@act} title={@title} aria-label={@title}><.icon
        name={@icon} /></button>
    """
  end

  @doc false
  def logo(assigns) do
    ~H"""
    <svg viewBox="0 0 32 32" fill="none" stroke="currentColor" stroke-width="2.6" stroke-linecap="round"
        stroke-linejoin="round" aria-hidden="true"><path d="M3 21h5l3-12 4 17 3-10 2 5h9"></path></svg>
    """
  end
end
