defmodule Situ.Infer.Face.Search do
  @moduledoc false
  # Chooses where to search for faces in the next image. BlazeFace sees its whole input as 128 pixels, so it misses
  # faces smaller than about a sixth of it, and its boxes of small faces are rough. The search therefore covers the
  # whole image, then a close-up of each face that is not large, and then a few tiles per image in rotation. The first
  # image is searched completely. While the faces rest, they are searched for only occasionally, and the images in
  # between are used for tiles. Pure: the caller passes the function that runs the detector.
  alias Situ.Infer.Face
  alias Situ.Infer.Face.{Blaze, Overlap}
  alias Situ.Infer.Patch
  alias Situ.Rect

  # A face of at least this share of the image's longer side is detected well enough in the whole image.
  @large 1 / 4
  # In a close-up the face fills a third of the network's input, the middle of its training range.
  @close_up 3.0
  @same 0.3
  # A face may be off the middle of its view by this share of the view's side.
  @rest 0.07
  # A face rests if its box overlaps its previous box by at least this much.
  @still 0.9
  # No other face is searched for within a face with at least this score.
  @sure 0.8
  # The tiles must cover everything once in this many images.
  @round 50
  # Tiles of a quarter of the image's shorter side, for faces of 40 pixels, are used if that side is at least this long.
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

  @doc "Finds the faces in the next image, of `size` `{width, height}`, taken at `time`."
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

  # The known faces are at rest, so only the next tiles are searched.
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

  # Returns the faces that need a close-up: faces of the previous image that are not among the large ones, and new ones.
  defp distant(before, large, small) do
    lost = Enum.filter(before, &Overlap.free?(&1, large, @same))
    lost ++ Enum.filter(small, &Overlap.free?(&1, lost, @same))
  end

  defp look_at_tiles(tiles, known, search, look) do
    sure = Enum.filter(known, &(&1.rect.score >= @sure))

    with {:ok, tiled} <- look_all(tiles, &look.(&1, search.tile_score)),
         do: confirm(tiled, sure, search.tile_score, look)
  end

  # A group of people can be mistaken for one large face, but it scores less than each of its members.
  defp merge(known, []), do: known

  defp merge(known, new),
    do: (known ++ new) |> Enum.sort_by(&(-&1.rect.score)) |> Overlap.suppress(@same)

  # A tile can cut an object so that it resembles a face, so a face found in a tile must also be found in a close-up.
  defp confirm(tiled, known, min_score, look) do
    tiled
    |> Enum.filter(&Overlap.free?(&1, known, @same))
    |> Enum.sort_by(&(-&1.rect.score))
    |> Overlap.suppress(@same)
    |> look_all(&close_up(&1, view(&1, []), min_score, look))
  end

  # Searches a view near the face's last position, ignoring other faces in the view. A face much smaller than expected
  # is searched once more, in a correspondingly smaller view.
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

  # A view does not move while the face in it rests. If it followed every wobble of the face, it would amplify the
  # wobble.
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

  @doc "Returns the patch with the whole image in the middle of a square, with black around it."
  @spec whole({pos_integer(), pos_integer()}) :: Patch.t()
  def whole({w, h}) do
    k = max(w, h)
    Patch.square({-div(k - w, 2) * 1.0, -div(k - h, 2) * 1.0}, k * 1.0, Blaze.size())
  end

  @doc """
  Returns half-overlapping squares over the image, with the image's shorter side and half of it; in large images also
  with a quarter of it.
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

  # Returns offsets from 0 to the last that fits, in steps of at most half a side.
  defp starts(length, side) when length <= side, do: [0]

  defp starts(length, side) do
    room = length - side
    steps = ceil(room / max(side / 2, 1))
    for i <- 0..steps, do: div(room * i, steps)
  end
end
