defmodule Situ.Infer.Face.Search do
  @moduledoc false
  # Where to look for faces in the next picture. BlazeFace sees its whole input as 128 pixels: it misses faces under
  # about a sixth of it, and boxes of small ones are rough. So a picture is looked at whole; then closely wherever
  # there is a face that is not large; then, a few tiles a picture in turn, everywhere else. The first picture is
  # looked at in full. While the faces rest, they are looked for only now and then, and the pictures between are used
  # for tiles. Pure: looking is the caller's function.
  alias Situ.Infer.Face
  alias Situ.Infer.Face.{Blaze, Overlap}
  alias Situ.Infer.Patch
  alias Situ.Rect

  # A face this share of the picture's longer side or more is seen well enough in the whole picture.
  @large 1 / 4
  # A face searched closely fills a third of what the network sees: the middle of what it was trained on.
  @close_up 3.0
  @same 0.3
  # By so much of a view's side its face may be off the middle.
  @rest 0.07
  # A face whose box is this much the same as before rests.
  @still 0.9
  # Within a face as sure as this no other is looked for.
  @sure 0.8
  # In so many pictures the tiles are to cover everything once.
  @round 50
  # Tiles a quarter as large as the picture's shorter side, for faces of 40 pixels, where that is at least this long.
  @fine 720

  @enforce_keys [:min_score, :tile_score, :tiles_per_picture, :every]
  defstruct [
    :min_score,
    :tile_score,
    :tiles_per_picture,
    :every,
    size: nil,
    tiles: [],
    turn: [],
    faces: [],
    views: [],
    looked_at: nil,
    resting?: false
  ]

  @type t :: %__MODULE__{}
  @type look :: (Patch.t(), float() -> {:ok, [Face.t()]} | {:error, Situ.Error.t()})

  @spec new(keyword()) :: t()
  def new(opts) do
    %__MODULE__{
      min_score: opts[:min_score],
      tile_score: max(opts[:min_score], opts[:tile_score]),
      tiles_per_picture: opts[:tiles],
      every: opts[:every]
    }
  end

  @doc "The faces in the next picture, of `size` `{width, height}`, shown at `time`."
  @spec step(t(), {pos_integer(), pos_integer()}, Situ.Time.t(), look()) ::
          {:ok, [Face.t()], t()} | {:error, Situ.Error.t()}
  def step(%__MODULE__{} = search, size, time, look) do
    cond do
      search.size != size -> search |> begin(size) |> look_everywhere(time, look)
      between?(search, time) -> look_between(search, look)
      search.resting? -> look_for_all(search, time, [], look)
      true -> look_in_turn(search, time, look)
    end
  end

  defp begin(search, size) do
    tiles = if search.tiles_per_picture == 0, do: [], else: tiles(size)
    %{search | size: size, tiles: tiles, turn: [], faces: [], views: []}
  end

  defp look_everywhere(search, time, look), do: look_for_all(search, time, search.tiles, look)

  defp between?(search, time),
    do: search.resting? and time >= search.looked_at and time - search.looked_at < search.every

  defp look_in_turn(search, time, look) do
    {now, search} = turn(search)
    look_for_all(search, time, now, look)
  end

  # The faces are where they were.
  defp look_between(search, look) do
    {now, search} = turn(search)

    with {:ok, new} <- look_at_tiles(now, search.faces, search, look) do
      faces = merge(search.faces, new)
      {:ok, faces, %{search | faces: faces, resting?: new == []}}
    end
  end

  defp look_for_all(%{size: size} = search, time, tiles, look) do
    with {:ok, whole} <- look.(whole(size), search.min_score),
         {large, small} = Enum.split_with(whole, &large?(&1, size)),
         distant = distant(search.faces, large, small),
         views = Map.new(distant, &{&1, view(&1, search.views)}),
         {:ok, close} <- look_all(distant, &close_up(&1, views[&1], search.min_score, look)),
         known = Overlap.suppress(large ++ close ++ small, @same),
         {:ok, new} <- look_at_tiles(tiles, known, search, look) do
      faces = merge(known, new)
      resting? = new == [] and resting?(search.faces, faces)
      found = %{faces: faces, views: Map.values(views), looked_at: time, resting?: resting?}
      {:ok, faces, Map.merge(search, found)}
    end
  end

  defp resting?(before, faces) do
    length(before) == length(faces) and
      Enum.all?(faces, fn face -> Enum.any?(before, &(Rect.iou(&1.rect, face.rect) >= @still)) end)
  end

  # Faces to look at closely: those of the picture before, and new ones.
  defp distant(before, large, small) do
    lost = Enum.filter(before, &Overlap.free?(&1, large, @same))
    lost ++ Enum.filter(small, &Overlap.free?(&1, lost, @same))
  end

  defp look_at_tiles(tiles, known, search, look) do
    sure = Enum.filter(known, &(&1.rect.score >= @sure))

    with {:ok, tiled} <- look_all(tiles, &look.(&1, search.tile_score)),
         do: confirm(tiled, sure, search.tile_score, look)
  end

  # A group of people may look like one large face, but never as much as each of them does.
  defp merge(known, []), do: known

  defp merge(known, new),
    do: (known ++ new) |> Enum.sort_by(&(-&1.rect.score)) |> Overlap.suppress(@same)

  # A tile cuts through things that then look like faces: what is found in one must look like one from close by, too.
  defp confirm(tiled, known, min_score, look) do
    tiled
    |> Enum.filter(&Overlap.free?(&1, known, @same))
    |> Enum.sort_by(&(-&1.rect.score))
    |> Overlap.suppress(@same)
    |> look_all(&close_up(&1, view(&1, []), min_score, look))
  end

  # The best view of a face near where it was; another face in the same view is left to its own. A face much smaller
  # than thought is looked at once more, from as near as it should be.
  defp close_up(face, {_, side} = view, min_score, look) do
    with {:ok, [found]} <- look_near(face, view, min_score, look),
         {_, wanted} = nearer = view(found, []),
         {:ok, refined} <-
           if(wanted < 0.6 * side, do: look_near(found, nearer, min_score, look), else: {:ok, []}) do
      {:ok, if(refined == [], do: [found], else: refined)}
    end
  end

  defp look_near(face, {{x, y}, side}, min_score, look) do
    corner = {x - side / 2, y - side / 2}

    with {:ok, found} <- look.(Patch.square(corner, side, Blaze.size()), min_score) do
      {:ok, found |> Enum.reject(&Overlap.free?(&1, [face], @same)) |> Enum.take(1)}
    end
  end

  # A view stays where it is while the face in it rests: moved with every wobble of the face, it would make it wobble
  # more.
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

  defp turn(search) do
    order = if search.turn == [], do: search.tiles, else: search.turn
    count = search.tiles_per_picture || ceil(length(search.tiles) / @round)
    {now, later} = Enum.split(order, count)
    {now, %{search | turn: later}}
  end

  @doc "The whole picture in the middle of a square, black around it."
  @spec whole({pos_integer(), pos_integer()}) :: Patch.t()
  def whole({w, h}) do
    k = max(w, h)
    Patch.square({-div(k - w, 2) * 1.0, -div(k - h, 2) * 1.0}, k * 1.0, Blaze.size())
  end

  @doc """
  Half-overlapping squares over the picture, as large as its shorter side and half that; in large pictures a quarter,
  too.
  """
  @spec tiles({pos_integer(), pos_integer()}) :: [Patch.t()]
  def tiles({w, h}) do
    short = min(w, h)

    sides = [short, div(short, 2)] ++ if(short >= @fine, do: [div(short, 4)], else: [])

    for side <- Enum.uniq(sides),
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
