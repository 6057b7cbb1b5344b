defmodule Situ.Space.StereoTest do
  use ExUnit.Case, async: true
  alias Situ.{DepthImage, Error, Image, ImageOps}
  alias Situ.Space.{Stereo, StereoDepth}

  @size {160, 96}

  # Random dots on a wall (disparity 6) with a box in front of it (disparity 20); the true disparities are exact.
  defp pair do
    {width, height} = @size
    state = :rand.seed_s(:exsss, 7)

    {dots, _} =
      Enum.map_reduce(1..(width * height * 2), state, fn _, s -> :rand.uniform_s(256, s) end)

    dots = List.to_tuple(dots)
    dot = fn x, y -> elem(dots, y * width * 2 + Integer.mod(x, width * 2)) - 1 end
    near? = fn x, y -> x in 60..110 and y in 24..72 end

    left = for y <- 0..(height - 1), x <- 0..(width - 1), into: <<>>, do: <<dot.(x, y)>>

    right =
      for y <- 0..(height - 1), x <- 0..(width - 1), into: <<>> do
        cond do
          near?.(x + 20, y) -> <<dot.(x + 20, y)>>
          # The box hides this from the left camera.
          near?.(x + 6, y) -> <<dot.(x + 6 + width, y)>>
          true -> <<dot.(x + 6, y)>>
        end
      end

    truth = for y <- 0..(height - 1), x <- 0..(width - 1), do: if(near?.(x, y), do: 20, else: 6)
    gray = &Image.new!(width: width, height: height, format: :gray8, data: &1)
    {gray.(left), gray.(right), truth}
  end

  defp share(disparities, truth, most) do
    found = for <<d::little-signed-16 <- disparities>>, do: d / 16
    pairs = Enum.filter(Enum.zip(found, truth), fn {_, t} -> t != nil end)
    Enum.count(pairs, fn {d, t} -> abs(d - t) <= most end) / length(pairs)
  end

  @tag :opencv
  test "computes disparities, and depth in meters, for a box in front of a wall" do
    {left, right, truth} = pair()
    {:ok, disparities} = Stereo.compute_disparity(left, right, count: 32)
    assert share(disparities, truth, 0.5) > 0.85
    {:ok, all} = Stereo.compute_disparity(left, right, count: 32, fill: true, whole: true)
    assert share(all, truth, 0.5) > 0.95

    {:ok, depth} = Stereo.compute_depth(left, right, count: 32, focal: 100, baseline: 0.12)
    assert {:ok, near} = DepthImage.fetch_distance(depth, 85, 48)
    assert_in_delta near, 12 / 20, 0.01
    assert {:ok, far} = DepthImage.fetch_distance(depth, 140, 10)
    assert_in_delta far, 12 / 6, 0.05
  end

  @tag :opencv
  test "runs on a stream, and a pair of different sizes is an error of the component" do
    {left, right, _} = pair()
    small = Image.new_filled(80, 96, :gray8)

    run = fn pairs ->
      Situ.to_list(fn p ->
        p
        |> Situ.from_enumerable(pairs, every: 1_000)
        |> Situ.via(StereoDepth, count: 32, focal: 100, baseline: 0.12)
      end)
    end

    assert [%DepthImage{width: 160}, %DepthImage{}] = run.([{left, right}, {left, right}])
    error = assert_raise Error, fn -> run.([{left, small}]) end
    assert Exception.message(error) =~ "160x96"
  end

  @tag :opencv
  test "rejects meaningless options" do
    {left, right, _} = pair()

    for {opts, says} <- [
          {[count: 33], "multiple of 16"},
          {[count: 160], "below the width"},
          {[block: 4], "block"}
        ] do
      assert {:error, %Error{code: :bad_option} = error} =
               Stereo.compute_disparity(left, right, opts)

      assert Exception.message(error) =~ says
    end
  end

  # Middlebury's motorcycle: `bin/lib/fetch-model stereo-motorcycle`.
  @cache System.get_env("SITU_MODELS") || :filename.basedir(:user_cache, "situ/models")
  @motorcycle Path.join(@cache, "stereo-motorcycle")
  @tag :opencv
  unless File.exists?(@motorcycle), do: @tag(skip: "not here: #{@motorcycle}")

  test "85 % of the pixels of a real pair are within 2 of their true disparity" do
    {:ok, left} = ImageOps.read(Path.join(@motorcycle, "motorcycle_left.png"))
    {:ok, right} = ImageOps.read(Path.join(@motorcycle, "motorcycle_right.png"))
    archive = String.to_charlist(Path.join(@motorcycle, "motorcycle_disp.npz"))
    {:ok, [{_, npy}]} = :zip.unzip(archive, [:memory])
    <<"\x93NUMPY", _::16, length::little-16, _::binary-size(length), numbers::binary>> = npy
    # Unknown disparities are stored as infinity, which is not a float in Elixir.
    truth =
      for <<bits::little-32 <- numbers>> do
        case <<bits::32>> do
          <<number::float-32>> -> number
          _ -> nil
        end
      end

    {:ok, found} = Stereo.compute_disparity(left, right)
    assert share(found, truth, 2) > 0.85
    {:ok, filled} = Stereo.compute_disparity(left, right, fill: true)
    assert share(filled, truth, 2) > 0.9
  end
end
