defmodule Situ.Infer.FaceLandmarks do
  @moduledoc """
  Finds 468 points on every face (MediaPipe's face mesh).

      frames |> Situ.join(faces) |> Situ.via(Situ.Infer.FaceLandmarks)

  Input `:in` is `{image, faces}`, a `Situ.Image` and the list of `Situ.Infer.Face` in it. Output `:out` is a list of
  `Situ.Infer.FaceMesh` in the same order. A face takes about 2.5 ms on one core, and the faces of an image are
  processed in parallel.
  """

  @schema Situ.Infer.BundledModel.schema() ++
            [
              margin: [
                type: {:range, 1.0, 4.0},
                default: 1.5,
                doc: "The width of the network's input patch, relative to the face."
              ],
              min_score: [
                type: {:range, 0.0, 1.0},
                default: 0.5,
                doc: "The minimum score; faces below it are dropped."
              ]
            ]

  use Situ.Component,
    inputs: [in: {{:tuple, [Situ.Image, {:list, Situ.Infer.Face}]}, optional: false}],
    outputs: [out: {:list, Situ.Infer.FaceMesh}],
    options: @schema

  alias Situ.Infer.{Activation, BundledModel, Face, FaceMesh, Model, Patch}

  @size 192
  @ports [
    inputs: %{"input_1" => {:f32, {1, @size, @size, 3}}},
    outputs: %{"conv2d_20" => {:f32, {1, 1, 1, 1404}}, "conv2d_30" => {:f32, {1, 1, 1, 1}}}
  ]

  defstruct [:model, :opts]

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts}}

  @impl true
  def handle_start(_context, state),
    do: {[], %{state | model: Situ.Error.unwrap!(load_network(state.opts))}}

  @impl true
  def handle_message(:in, %{data: {image, faces}} = message, _context, state) do
    faces = Enum.map(faces, &Face.check!/1)
    meshes = Situ.Error.unwrap!(find_meshes(state.model, image, faces, state.opts))
    {[{:out, message.originating_time, meshes}], state}
  end

  @impl true
  def describe(state), do: Model.describe_runs(state.model)

  @doc "Loads the network, which all callers share."
  @spec load_network(keyword()) :: {:ok, Model.t()} | {:error, Situ.Error.t()}
  def load_network(opts), do: BundledModel.load(opts, "face_landmark.onnx", @ports)

  @doc "Finds the points of `faces` in `image`. Returns the errors of `Situ.Infer.Model` and `:bad_image`."
  @spec find_meshes(Model.t(), Situ.Image.t(), [Face.t()], keyword()) ::
          {:ok, [FaceMesh.t()]} | {:error, Situ.Error.t()}
  def find_meshes(model, image, faces, opts \\ []) do
    min_score = opts[:min_score] || 0.5
    meshes = map_in_parallel(faces, &find_mesh(model, image, &1, opts[:margin] || 1.5))

    with nil <- Enum.find(meshes, &match?({:error, _}, &1)) do
      {:ok, for({:ok, mesh} <- meshes, mesh.score >= min_score, do: mesh)}
    end
  end

  # The first face is processed here and each other face in a separate process, so that they use all cores.
  defp map_in_parallel([], _fun), do: []

  defp map_in_parallel([first | others], fun) do
    tasks = Enum.map(others, &Task.async(fn -> fun.(&1) end))
    [fun.(first) | Task.await_many(tasks, :infinity)]
  end

  defp find_mesh(model, image, face, margin) do
    patch = Face.level_patch(face, margin, @size)

    with {:ok, tensor} <- Patch.cut_tensor(patch, image, 1 / 255, 0.0),
         {:ok, outputs} <- Model.run(model, %{"input_1" => tensor}) do
      %{"conv2d_20" => points, "conv2d_30" => %{data: <<logit::float-native-32>>}} = outputs

      {:ok,
       %FaceMesh{
         id: face.rect.id,
         rect: face.rect,
         score: Activation.sigmoid(logit),
         points: points.data,
         patch: patch
       }}
    end
  end
end
