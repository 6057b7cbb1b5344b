defmodule Situ.Space.RayTable do
  @moduledoc """
  The ray direction of every pixel of a camera, computed once and used for every depth image of that camera.

      {:ok, table} = Situ.Space.RayTable.new(intrinsics)
      {:ok, cloud} = Situ.Space.Depth.to_cloud(depth, table)
  """
  alias Situ.{CameraIntrinsics, Error}
  alias Situ.Space.NativeCall

  @enforce_keys [:width, :height, :rays]
  defstruct [:width, :height, :rays]

  @typedoc "`rays` holds two 32-bit little-endian floats per pixel: where its ray meets the plane at distance 1."
  @type t :: %__MODULE__{width: pos_integer(), height: pos_integer(), rays: binary()}

  @schema [
    undistort: [
      type: :boolean,
      default: true,
      doc: "Whether to remove the lens distortion."
    ]
  ]

  @doc """
  Builds the table of a camera. Pixels whose distortion cannot be removed have no ray and yield no point.

  #{Situ.Options.docs(@schema)}

      iex> camera = Situ.CameraIntrinsics.new!(width: 4, height: 2, focal: {2, 2})
      iex> {:ok, table} = Situ.Space.RayTable.new(camera)
      iex> {table.width, table.height, byte_size(table.rays)}
      {4, 2, 64}
  """
  @spec new(CameraIntrinsics.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(%CameraIntrinsics{} = c, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         camera = {c.width, c.height, c.focal, c.principal, c.radial, c.tangential, c.distorts?},
         {:ok, rays} <- NativeCall.call_native(:ray_table, [camera, opts[:undistort]]),
         do: {:ok, %__MODULE__{width: c.width, height: c.height, rays: rays}}
  end

  @doc "Returns a table unchanged, or builds the table of a camera."
  @spec ensure_table(t() | CameraIntrinsics.t()) :: {:ok, t()} | {:error, Error.t()}
  def ensure_table(%__MODULE__{} = table), do: {:ok, table}
  def ensure_table(%CameraIntrinsics{} = camera), do: new(camera)
end
