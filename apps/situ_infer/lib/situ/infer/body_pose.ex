defmodule Situ.Infer.BodyPose do
  @moduledoc """
  Finds the body of the person in front of the camera: 33 points in the image, and a skeleton
  (MediaPipe's BlazePose).

  Input `:in` is a `Situ.Image` of an 8-bit format. Each image produces a message on each output, at its time (an empty
  list if nobody is found):

    * `:out`: the points as `Situ.Point2` in image pixels, in the order of `joint_names/0`; points outside the image are
      estimates;
    * `:skeletons`: a list of one `Situ.Skeleton`, in metres around the middle of the hips, with x away from the camera,
      y to its left and z up. The confidence of each joint is the probability that it is visible.

        body = Situ.via(pictures, Situ.Infer.BodyPose)
        Situ.Store.write(body.out, store, "Body.Points")
        Situ.Store.write(body.skeletons, store, "Body")

  "Left" is the person's left. The component finds one upright person who fills much of the image, and tracks that
  person from image to image. To find smaller people, crop the image first. Sizes in metres assume an average adult,
  since the network does not measure them. One detection takes about 12 ms on one core; the first image needs two.

  To use it without a pipeline, see `find_body/2`.
  """

  @schema Situ.Infer.BundledModel.schema() ++
            [
              min_score: [
                type: {:range, 0.01, 0.99},
                default: 0.5,
                doc: "The minimum score for a body."
              ]
            ]

  @joints ~w(nose left_eye_inner left_eye left_eye_outer right_eye_inner right_eye right_eye_outer left_ear right_ear
             mouth_left mouth_right left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist
             left_pinky right_pinky left_index right_index left_thumb right_thumb left_hip right_hip left_knee
             right_knee left_ankle right_ankle left_heel right_heel left_foot_index right_foot_index)a

  use Situ.Component,
    inputs: [in: Situ.Image],
    outputs: [out: {:list, Situ.Point2}, skeletons: {:list, Situ.Skeleton}],
    options: @schema

  alias Situ.{Error, Image, Point2, Pose, Skeleton, Tensor}
  alias Situ.Infer.{Activation, BundledModel, Model, Patch}

  @side 256
  # The network returns 39 points: the named 33, the middle of the hips, a point above the head, and four unknown ones.
  @all_points 39
  @ports [
    inputs: %{"input" => {:f32, {1, @side, @side, 3}}},
    outputs: %{
      "points" => {:f32, {1, 195}},
      "score" => {:f32, {1, 1}},
      "world" => {:f32, {1, 117}}
    }
  ]
  @bones [
    nose: :left_eye,
    nose: :right_eye,
    left_eye: :left_ear,
    right_eye: :right_ear,
    mouth_left: :mouth_right,
    left_shoulder: :right_shoulder,
    left_shoulder: :left_elbow,
    left_elbow: :left_wrist,
    left_wrist: :left_index,
    right_shoulder: :right_elbow,
    right_elbow: :right_wrist,
    right_wrist: :right_index,
    left_shoulder: :left_hip,
    right_shoulder: :right_hip,
    left_hip: :right_hip,
    left_hip: :left_knee,
    left_knee: :left_ankle,
    left_ankle: :left_foot_index,
    right_hip: :right_knee,
    right_knee: :right_ankle,
    right_ankle: :right_foot_index
  ]

  @typedoc "The body in an image: its points and its skeleton; both lists are empty if nobody was found."
  @type detection :: %{points: [Point2.t()], skeletons: [Skeleton.t()]}

  # `region` is where the body was last found: `{middle, side, angle}`.
  defstruct [:opts, :model, :region]

  @doc "Returns the names of the points, in order."
  @spec joint_names() :: [atom()]
  def joint_names, do: @joints

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: opts}}

  @impl true
  def handle_start(_context, %{opts: opts} = state),
    do: {[], %{state | model: Error.unwrap!(load_model(opts))}}

  @impl true
  def handle_message(:in, %{data: image, originating_time: time}, _context, state) do
    {detection, region} = Error.unwrap!(find_with_tracking(state, image))

    {[{:out, time, detection.points}, {:skeletons, time, detection.skeletons}],
     %{state | region: region}}
  end

  @impl true
  def describe(state), do: Model.describe_runs(state.model)

  @doc """
  Finds the body in one image, without a pipeline. See the options above. Returns the errors of `Situ.Infer.Model` and
  `:bad_image`.
  """
  @spec find_body(Image.t(), keyword()) :: {:ok, detection()} | {:error, Error.t()}
  def find_body(%Image{} = image, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, model} <- load_model(opts),
         {:ok, {detection, _region}} <-
           find_with_tracking(%__MODULE__{opts: opts, model: model}, image),
         do: {:ok, detection}
  end

  defp load_model(opts), do: BundledModel.load(opts, "body.onnx", @ports)

  # Searches the last region, and otherwise the whole image and then a closer region.
  defp find_with_tracking(%{region: nil} = state, image) do
    with {:ok, rough} <- detect_in_region(state, image, whole_image_region(image)),
         {:ok, close} <-
           if(rough, do: detect_in_region(state, image, rough.next), else: {:ok, nil}),
         do: {:ok, to_found(close || rough)}
  end

  defp find_with_tracking(%{region: region} = state, image) do
    case detect_in_region(state, image, region) do
      {:ok, nil} -> find_with_tracking(%{state | region: nil}, image)
      {:ok, body} -> {:ok, to_found(body)}
      error -> error
    end
  end

  # The margin is needed because a body at the edge extends beyond the image.
  defp whole_image_region(%Image{width: w, height: h}),
    do: {{w / 2, h / 2}, max(w, h) * 1.25, 0.0}

  defp to_found(nil), do: {%{points: [], skeletons: []}, nil}
  defp to_found(body), do: {%{points: body.points, skeletons: [body.skeleton]}, body.next}

  defp detect_in_region(%{model: model, opts: opts}, image, {middle, side, angle}) do
    patch = Patch.centered_at(middle, side, angle, @side)

    with {:ok, tensor} <- Patch.cut_tensor(patch, image, 1 / 255, 0.0),
         {:ok, outputs} <- Model.run(model, %{"input" => tensor}) do
      {:ok, parse_outputs(outputs, patch, angle, opts[:min_score])}
    end
  end

  # Outputs that are not finite numbers count as no body.
  defp parse_outputs(
         %{"points" => points, "score" => score, "world" => world},
         patch,
         angle,
         min_score
       ) do
    rows = points |> Tensor.to_list() |> Enum.chunk_every(5)
    [score] = Tensor.to_list(score)
    world = world |> Tensor.to_list() |> Enum.chunk_every(3)

    if is_number(score) and score >= min_score and
         Enum.all?(List.flatten([rows, world]), &is_number/1) do
      positions = for [x, y | _] <- rows, do: Patch.to_image_point(patch, {x, y})

      visibility = for [_, _, _, logit, _] <- rows, do: Activation.sigmoid(logit)

      %{
        points: for({x, y} <- Enum.take(positions, length(@joints)), do: Point2.new(x, y)),
        skeleton: build_skeleton(world, visibility, angle),
        next:
          next_region(Enum.at(positions, @all_points - 6), Enum.at(positions, @all_points - 5))
      }
    end
  end

  # The region holds the body with its arms spread, and is upright with respect to the body.
  defp next_region({x, y} = middle, {tx, ty}) do
    {dx, dy} = {tx - x, ty - y}
    {middle, max(2.5 * :math.sqrt(dx * dx + dy * dy), 8.0), :math.atan2(dx, -dy)}
  end

  defp build_skeleton(world, visibility, angle) do
    {cos, sin} = {:math.cos(angle), :math.sin(angle)}

    joints =
      for {name, [x, y, z]} <- Enum.zip(@joints, world), into: %{} do
        # Converts from the patch (right, down, away) to the upright image, and then to ahead, left, up.
        {name, Pose.new({z, -(cos * x - sin * y), -(sin * x + cos * y)})}
      end

    Skeleton.new!(joints, @bones, id: 0, confidence: @joints |> Enum.zip(visibility) |> Map.new())
  end
end
