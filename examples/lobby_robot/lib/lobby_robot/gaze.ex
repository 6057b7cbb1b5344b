defmodule LobbyRobot.Gaze do
  @moduledoc """
  Estimates from the points of a face whether it is turned to the camera: then the tip of the nose is in the middle
  between the eyes.
  """
  alias Situ.Infer.FaceMesh

  @nose 1
  @right_eye 33
  @left_eye 263
  # About 15 degrees.
  @most_turned 0.15

  @doc "Returns for the id of each face whether it looks at the camera."
  @spec looks([FaceMesh.t()]) :: %{term() => boolean()}
  def looks(meshes), do: Map.new(meshes, &{&1.id, abs(turn(&1)) < @most_turned})

  @doc "Returns how far the nose is from the middle between the eyes, relative to their distance; 0 is straight ahead."
  @spec turn(FaceMesh.t()) :: float()
  def turn(mesh) do
    [{nose, _}, {right, _}, {left, _}] =
      for point <- [@nose, @right_eye, @left_eye], do: FaceMesh.point_at(mesh, point)

    (nose - (right + left) / 2) / abs(left - right)
  end
end
