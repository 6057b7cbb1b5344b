defmodule Situ.Studio.Application do
  @moduledoc false
  use Application

  @drawn [Situ.Image, Situ.EncodedImage, Situ.DepthImage, Situ.AudioBuffer, Situ.AudioFormat] ++
           [Situ.Rect, Situ.Point2, Situ.Point3, Situ.GeoPoint]

  @impl true
  def start(_type, _args) do
    # Recorded structs of these modules can be decoded only after the atoms of their fields exist.
    Enum.each(@drawn, &Code.ensure_loaded/1)

    # One registry for all studios of the VM: pages find their studio by the name in their session.
    children = [
      {Registry, keys: :unique, name: Situ.Studio.Registry},
      # Lets pages that show the same item find each other.
      {Registry, keys: :duplicate, name: Situ.Studio.Peers},
      {Task.Supervisor, name: Situ.Studio.Tasks}
    ]

    Supervisor.start_link(children, strategy: :one_for_one, name: Situ.Studio.Supervisor)
  end
end
