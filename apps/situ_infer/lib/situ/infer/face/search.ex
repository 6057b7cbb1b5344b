defmodule Situ.Infer.Face.Search do
  @moduledoc false
  # Chooses where to search for faces in the next image. BlazeFace sees its whole input as 128 pixels, so it misses
  # faces smaller than about a sixth of it, and its boxes of small faces are rough. The search therefore covers the
  # whole image, then a close-up of each face that is not large, and then a few tiles per image in rotation. The first
  # image is searched completely. While the faces rest, they are searched for only occasionally, and the images in
  # between are used for tiles. Pure: the caller passes the function that runs the detector.
  alias Situ.Infer.Face
  alias Situ.Infer.Face.Blaze
  alias Situ.Infer.{Patch, Suppression}
  alias Situ.Rect

  # A face of at least this share of the image's longer side is detected well enough in the whole image.
  @large 1 / 4
  # In a close-up the face fills a third of the network's input, the middle of its training range.
  @close_up 3.0
  @same 0.3
  # A face may be off the middle of its view by this share of the view's side.
  @rest 0.07
  # A face is at rest if its box overlaps its previous box by at least this much.
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
    next_tiles: [],
    faces: [],
    views: [],
    searched_at: nil,
    resting?: false
  ]

  @type t :: %__MODULE__{}
  @type detect :: (Patch.t(), float() -> {:ok, [Face.t()]} | {:error, Situ.Error.t()})

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
  @spec search_image(t(), {pos_integer(), pos_integer()}, Situ.Time.t(), detect()) ::
          {:ok, [Face.t()], t()} | {:error, Situ.Error.t()}
  def search_image(%__MODULE__{} = search, size, time, detect) do
    cond do
      search.size != size -> search |> reset_for_size(size) |> search_everything(time, detect)
      rest_interval?(search, time) -> search_next_tiles(search, detect)
      search.resting? -> search_all_scales(search, time, [], detect)
      true -> search_with_next_tiles(search, time, detect)
    end
  end

  defp reset_for_size(search, size) do
    tiles = if search.tiles_per_picture == 0, do: [], else: image_tiles(size)
    %{search | size: size, tiles: tiles, next_tiles: [], faces: [], views: []}
  end

  defp search_everything(search, time, detect),
    do: search_all_scales(search, time, search.tiles, detect)

  defp rest_interval?(search, time),
    do:
      search.resting? and time >= search.searched_at and time - search.searched_at < search.every

  defp search_with_next_tiles(search, time, detect) do
    {now, search} = next_tiles(search)
    search_all_scales(search, time, now, detect)
  end

  # The known faces are at rest, so only the next tiles are searched.
  defp search_next_tiles(search, detect) do
    {now, search} = next_tiles(search)

    with {:ok, new} <- search_tiles(now, search.faces, search, detect) do
      faces = merge_faces(search.faces, new)
      {:ok, faces, %{search | faces: faces, resting?: new == []}}
    end
  end

  defp search_all_scales(%{size: size} = search, time, tiles, detect) do
    with {:ok, whole} <- detect.(whole_image_patch(size), search.min_score),
         {large, small} = Enum.split_with(whole, &large_face?(&1, size)),
         distant = close_up_faces(search.faces, large, small),
         views = Map.new(distant, &{&1, choose_view(&1, search.views)}),
         {:ok, close} <-
           search_patches(distant, &search_close_up(&1, views[&1], search.min_score, detect)),
         known = Suppression.suppress_faces(large ++ close ++ small, @same),
         {:ok, new} <- search_tiles(tiles, known, search, detect) do
      faces = merge_faces(known, new)
      resting? = new == [] and faces_still?(search.faces, faces)
      found = %{faces: faces, views: Map.values(views), searched_at: time, resting?: resting?}
      {:ok, faces, Map.merge(search, found)}
    end
  end

  defp faces_still?(before, faces) do
    length(before) == length(faces) and
      Enum.all?(faces, fn face -> Enum.any?(before, &(Rect.iou(&1.rect, face.rect) >= @still)) end)
  end

  # Returns the faces that need a close-up: faces of the previous image that are not among the large ones, and new ones.
  defp close_up_faces(before, large, small) do
    lost = Enum.reject(before, &known_face?(&1, large))
    lost ++ Enum.reject(small, &known_face?(&1, lost))
  end

  defp search_tiles(tiles, known, search, detect) do
    sure = Enum.filter(known, &(&1.rect.score >= @sure))

    with {:ok, tiled} <- search_patches(tiles, &detect.(&1, search.tile_score)),
         do: confirm_tile_faces(tiled, sure, search.tile_score, detect)
  end

  # A group of people can be mistaken for one large face, but it scores less than each of its members.
  defp merge_faces(known, []), do: known

  defp merge_faces(known, new),
    do: (known ++ new) |> Enum.sort_by(&(-&1.rect.score)) |> Suppression.suppress_faces(@same)

  # A tile can cut an object so that it resembles a face, so a face found in a tile must also be found in a close-up.
  defp confirm_tile_faces(tiled, known, min_score, detect) do
    tiled
    |> Enum.reject(&known_face?(&1, known))
    |> Enum.sort_by(&(-&1.rect.score))
    |> Suppression.suppress_faces(@same)
    |> search_patches(&search_close_up(&1, choose_view(&1, []), min_score, detect))
  end

  # Searches a view near the face's last position, ignoring other faces in the view. A face much smaller than expected
  # is searched once more, in a correspondingly smaller view.
  defp search_close_up(face, {_, side} = view, min_score, detect) do
    with {:ok, [found]} <- search_near(face, view, min_score, detect),
         {_, wanted} = nearer = choose_view(found, []),
         {:ok, refined} <-
           if(wanted < 0.6 * side,
             do: search_near(found, nearer, min_score, detect),
             else: {:ok, []}
           ) do
      {:ok, if(refined == [], do: [found], else: refined)}
    end
  end

  defp search_near(face, {{x, y}, side}, min_score, detect) do
    corner = {x - side / 2, y - side / 2}

    with {:ok, found} <- detect.(Patch.from_square(corner, side, Blaze.input_size()), min_score) do
      {:ok, found |> Enum.filter(&Suppression.same_face?(&1, face, @same)) |> Enum.take(1)}
    end
  end

  # A view does not move while the face in it is at rest. If the view followed every wobble of the face, it would
  # amplify the wobble.
  defp choose_view(face, views) do
    side = max(face.rect.width, face.rect.height) * @close_up
    middle = Situ.Rect.center_point(face.rect)

    Enum.find(views, {{middle.x, middle.y}, side}, fn {{x, y}, old} ->
      abs(x - middle.x) < old * @rest and abs(y - middle.y) < old * @rest and
        side / old > 0.8 and side / old < 1.25
    end)
  end

  defp search_patches(patches, detect) do
    with {:ok, faces} <- Situ.Error.map_ok(patches, detect), do: {:ok, Enum.concat(faces)}
  end

  defp known_face?(face, known), do: Enum.any?(known, &Suppression.same_face?(face, &1, @same))

  defp large_face?(face, {w, h}), do: max(face.rect.width, face.rect.height) >= max(w, h) * @large

  defp next_tiles(search) do
    order = if search.next_tiles == [], do: search.tiles, else: search.next_tiles
    count = search.tiles_per_picture || ceil(length(search.tiles) / @round)
    {now, later} = Enum.split(order, count)
    {now, %{search | next_tiles: later}}
  end

  @doc "Returns the patch with the whole image in the middle of a square, with black around it."
  @spec whole_image_patch({pos_integer(), pos_integer()}) :: Patch.t()
  def whole_image_patch({w, h}) do
    k = max(w, h)
    Patch.from_square({-div(k - w, 2) * 1.0, -div(k - h, 2) * 1.0}, k * 1.0, Blaze.input_size())
  end

  @doc """
  Returns half-overlapping squares over the image, with the image's shorter side and half of it; in large images also
  with a quarter of it.
  """
  @spec image_tiles({pos_integer(), pos_integer()}) :: [Patch.t()]
  def image_tiles({w, h}) do
    short = min(w, h)

    sides = [short, div(short, 2)] ++ if(short >= @fine, do: [div(short, 4)], else: [])

    for side <- Enum.uniq(sides),
        side >= Blaze.input_size() or side == short,
        side < max(w, h),
        y <- tile_offsets(h, side),
        x <- tile_offsets(w, side),
        do: Patch.from_square({x * 1.0, y * 1.0}, side * 1.0, Blaze.input_size())
  end

  # Returns offsets from 0 to the last that fits, in steps of at most half a side.
  defp tile_offsets(length, side) when length <= side, do: [0]

  defp tile_offsets(length, side) do
    room = length - side
    steps = ceil(room / max(side / 2, 1))
    for i <- 0..steps, do: div(room * i, steps)
  end
end
