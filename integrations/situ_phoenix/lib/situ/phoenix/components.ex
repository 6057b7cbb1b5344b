defmodule Situ.Phoenix.Components do
  @moduledoc """
  Components for the pages of a Phoenix application.

      import Situ.Phoenix.Components

      <.situ_panel stream={{Lab.Pipeline, "Level"}} />
      <.situ_panel stream={{Lab.Pipeline, "Camera"}} every={200} />
  """
  use Phoenix.Component

  attr(:stream, :any, required: true, doc: "`{pipeline, name}`, see `Situ.Subscription`")
  attr(:id, :string, default: nil, doc: "required if two panels show streams of the same name")
  attr(:title, :string, default: nil, doc: "default: the stream's name")
  attr(:every, :integer, default: 100, doc: "the minimum time between two drawings in ms")
  attr(:seconds, :integer, default: 10, doc: "the time span of a plot")
  attr(:width, :integer, default: 480, doc: "the width of a plot in pixels")
  attr(:height, :integer, default: 140, doc: "the height of a plot in pixels")

  @doc """
  Shows a stream of a running pipeline in a LiveView: numbers as a plot of the last seconds, images as a picture, all
  other values as `Situ.Studio.Preview` draws them. It needs no script. A pipeline that restarts is
  followed if it is given by its name.
  """
  def situ_panel(%{stream: {_pipeline, name}} = assigns) do
    assigns =
      assign(assigns, id: assigns.id || "situ-panel-" <> name, title: assigns.title || name)

    ~H"""
    <.live_component
      module={Situ.Phoenix.Panel}
      id={@id}
      stream={@stream}
      title={@title}
      every={@every}
      seconds={@seconds}
      size={[width: @width, height: @height]}
    />
    """
  end
end
