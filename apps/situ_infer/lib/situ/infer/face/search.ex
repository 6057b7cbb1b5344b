defmodule Situ.Infer.Face.Search do
  @moduledoc false
  # Where to look for faces in the next picture. BlazeFace sees its whole input as 128 pixels and misses faces under about a
  # sixth of it, so a picture is looked at whole; then closely wherever a small face was a moment ago; then, a few tiles a picture
  # in turn, everywhere else. The first picture is looked at in full. Pure: looking is the caller's function.
  alias Situ.Infer.Face
  alias Situ.Infer.Face.{Blaze, Overlap}
  alias Situ.Infer.Patch

  # A face this share of the picture's longer side or more is seen well enough in the whole picture.
  @large 1 / 8
  # A face searched closely fills a third of what the network sees: the middle of what it was trained on.
  @close_up 3.0
  @same 0.3
  # By so much of a view's side its face may be off the middle.
  @rest 0.07

  @enforce_keys [:min_score, :tile_score, :tiles_per_picture]
  defstruct [
    :min_score,
    :tile_score,
    :tiles_per_picture,
    size: nil,
    tiles: [],
    turn: [],
    faces: [],
    views: []
  ]

  @type t :: %__MODULE__{}
  @type look :: (Patch.t(), float() -> {:ok, [Face.t()]} | {:error, Situ.Error.t()})

  @spec new(keyword()) :: t()
  def new(opts) do
    %__MODULE__{
      min_score: opts[:min_score],
      tile_score: max(opts[:min_score], opts[:tile_score]),
      tiles_per_picture: opts[:tiles]
    }
  end

  @doc "The faces in the next picture of `size` `{width, height}`."
  @spec step(t(), {pos_integer(), pos_integer()}, look()) ::
          {:ok, [Face.t()], t()} | {:error, Situ.Error.t()}
  def step(%__MODULE__{} = search, size, look) do
    {now, search} = turn(search, size)

    with {:ok, whole} <- look.(whole(size), search.min_score),
         {large, small} = Enum.split_with(whole, &large?(&1, size)),
         distant = distant(search.faces, large, small),
         views = Map.new(distant, &{&1, view(&1, search.views)}),
         {:ok, close} <- look_all(distant, &close_up(&1, views[&1], search.min_score, look)),
         {:ok, tiled} <- look_all(now, &look.(&1, search.tile_score)),
         known = large ++ close ++ small,
         {:ok, new} <- confirm(tiled, known, search.tile_score, look) do
      faces = Overlap.suppress(known ++ new, @same)
      {:ok, faces, %{search | faces: faces, views: Map.values(views)}}
    end
  end

  # Small faces to look at closely: those of the picture before, and new ones.
  defp distant(before, large, small) do
    lost = Enum.filter(before, &Overlap.free?(&1, large, @same))
    lost ++ Enum.filter(small, &Overlap.free?(&1, lost, @same))
  end

  # A tile cuts through things that then look like faces: what is found in one must look like one from close by, too.
  defp confirm(tiled, known, min_score, look) do
    tiled
    |> Enum.filter(&Overlap.free?(&1, known, @same))
    |> Enum.sort_by(&(-&1.rect.score))
    |> Overlap.suppress(@same)
    |> look_all(&close_up(&1, view(&1, []), min_score, look))
  end

  # The best view of a face near where it was; another face in the same view is left to its own.
  defp close_up(face, {{x, y}, side}, min_score, look) do
    corner = {x - side / 2, y - side / 2}

    with {:ok, found} <- look.(Patch.square(corner, side, Blaze.size()), min_score) do
      {:ok, found |> Enum.filter(&(Situ.Rect.iou(&1.rect, face.rect) > @same)) |> Enum.take(1)}
    end
  end

  # A view stays where it is while the face in it rests: moved with every wobble of the face, it would make it wobble more.
  defp view(face, views) do
    side = max(face.rect.width, face.rect.height) * @close_up
    middle = Situ.Rect.center(face.rect)

    Enum.find(views, {{middle.x, middle.y}, side}, fn {{x, y}, old} ->
      abs(x - middle.x) < old * @rest and abs(y - middle.y) < old * @rest and
        side / old > 0.8 and side / old < 1.25
    end)
  end

  defp look_all(places, look) do
    Enum.reduce_while(places, {:ok, []}, fn place, {:ok, found} ->
      case look.(place) do
        {:ok, faces} -> {:cont, {:ok, found ++ faces}}
        {:error, _} = error -> {:halt, error}
      end
    end)
  end

  defp large?(face, {w, h}), do: max(face.rect.width, face.rect.height) >= max(w, h) * @large

  defp turn(%{tiles_per_picture: 0} = search, size), do: {[], %{search | size: size}}

  defp turn(%{size: size} = search, size) do
    order = if search.turn == [], do: search.tiles, else: search.turn
    {now, later} = Enum.split(order, search.tiles_per_picture)
    {now, %{search | turn: later}}
  end

  defp turn(search, size) do
    tiles = tiles(size)
    {tiles, %{search | size: size, tiles: tiles, turn: [], faces: [], views: []}}
  end

  @doc "The whole picture in the middle of a square, black around it."
  @spec whole({pos_integer(), pos_integer()}) :: Patch.t()
  def whole({w, h}) do
    k = max(w, h)
    Patch.square({-div(k - w, 2) * 1.0, -div(k - h, 2) * 1.0}, k * 1.0, Blaze.size())
  end

  @doc "Half-overlapping squares over the picture, as large as its shorter side and half that."
  @spec tiles({pos_integer(), pos_integer()}) :: [Patch.t()]
  def tiles({w, h}) do
    short = min(w, h)

    for side <- Enum.uniq([short, div(short, 2)]),
        side >= Blaze.size() or side == short,
        side < max(w, h),
        y <- starts(h, side),
        x <- starts(w, side),
        do: Patch.square({x * 1.0, y * 1.0}, side * 1.0, Blaze.size())
  end

  # From 0 to the last place that still fits, in steps of at most half a side.
  defp starts(length, side) when length <= side, do: [0]

  defp starts(length, side) do
    room = length - side
    steps = ceil(room / max(side / 2, 1))
    for i <- 0..steps, do: div(room * i, steps)
  end
end
